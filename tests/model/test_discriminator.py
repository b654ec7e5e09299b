import pytest
import torch

from nmbg.model.discriminator import Discriminator, size_for


@pytest.mark.parametrize(("size", "count"), [(256, 2_802_432), (512, 2_804_096)])
def test_parameters_are_the_papers(size: int, count: int) -> None:
    discriminator = Discriminator(size)
    assert sum(p.numel() for p in discriminator.parameters()) == count
    assert len(discriminator.halve) == {256: 6, 512: 7}[size]
    assert discriminator(torch.rand(2, 3, size, size)).shape == (2,)


def test_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="256 or 512"):
        Discriminator(300)


@pytest.mark.parametrize(
    ("width", "height", "expected"), [(100, 900, 256), (256, 511, 256), (512, 512, 512), (4000, 3000, 512)]
)
def test_images_are_not_enlarged_where_they_need_not_be(width: int, height: int, expected: int) -> None:
    assert size_for(width, height) == expected
