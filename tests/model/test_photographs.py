from collections.abc import Callable, Set
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nmbg.cameras import Camera
from nmbg.model.photographs import Gathered, OnMesh, Photographs, count_features
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene, View
from nmbg.sight import look
from nmbg.training.config import PRESETS
from nmbg.training.start import mean_colours


@pytest.fixture
def scene(scene_folder: Path) -> Scene:
    return Scene.load(scene_folder)


def grey(camera: Camera) -> torch.Tensor:
    return torch.full((3, camera.height, camera.width), 0.5)


def grey_mesh(scene: Scene) -> OnMesh:
    return lambda camera: ([grey(camera)], look(scene.mesh, camera).depth)


def gather(photographs: Photographs, camera: Camera, without: Set[str] = frozenset()) -> Gathered:
    return photographs.gather(camera, grey(camera), look(photographs.scene.mesh, camera).depth, without)


def test_photographs_mend_a_grey_mesh(scene: Scene) -> None:
    """The second training view, itself left out, over a mesh of one grey."""
    view = scene.train[1]
    gathered = gather(Photographs(scene, scene.train, grey_mesh(scene), sources=3), view.camera, {view.name})
    photo = torch.from_numpy(scene.load_image(view)).permute(2, 0, 1) / 255
    seen = gathered.trust > 0.5
    assert seen.sum() > 1000
    error = (gathered.blended() - photo).abs().mean(0)[seen].median()
    assert error < 0.5 * (grey(view.camera) - photo).abs().mean(0)[seen].median()


def test_a_photograph_that_is_not_left_out_shows_itself(scene: Scene) -> None:
    view = scene.train[1]
    photographs = Photographs(scene, scene.train, grey_mesh(scene), sources=1)
    gathered = gather(photographs, view.camera)
    photo = torch.from_numpy(scene.load_image(view)).permute(2, 0, 1) / 255
    sure = gathered.score > 0.9
    assert sure.float().mean() > 0.3
    # Residuals are kept in 8 bits over a range of 2, images in float16.
    assert (gathered.blended() - photo).abs()[:, sure].max() < 0.01


def test_blended_over_the_mesh_is_what_was_gathered(scene: Scene) -> None:
    """Up to the rounding to float16; also where no photograph sees the mesh, and with none at all."""
    camera = scene.test[0].camera
    base, depth = torch.rand(3, camera.height, camera.width), look(scene.mesh, camera).depth
    photographs = Photographs(scene, scene.train[:1], grey_mesh(scene), sources=3)
    for without in (frozenset(), {scene.train[0].name}):
        gathered, blended = (f(camera, base, depth, without) for f in (photographs.gather, photographs.over))
        assert (gathered.trust == 0).any()
        torch.testing.assert_close(blended, gathered.blended(), rtol=0, atol=2e-3)
        exposed = photographs.exposure(camera, without).apply(base)
        assert torch.equal(blended[:, gathered.trust == 0], exposed[:, gathered.trust == 0])


def test_left_out_means_unused(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Painting the photograph that is left out black changes nothing; painting another one does."""
    view, other = scene.train[1], scene.train[2]
    load_image = Scene.load_image

    def gathered(black: str) -> torch.Tensor:
        def painted(self: Scene, asked: object) -> object:
            image = load_image(self, asked)  # type: ignore[arg-type]
            return np.zeros_like(image) if asked.name == black else image  # type: ignore[attr-defined]

        monkeypatch.setattr(Scene, "load_image", painted)
        photographs = Photographs(scene, scene.train, grey_mesh(scene), sources=3)
        return gather(photographs, view.camera, {view.name}).blended()

    assert torch.equal(gathered(""), gathered(view.name))
    assert not torch.equal(gathered(""), gathered(other.name))


def test_where_no_photograph_looks_the_mesh_shows(scene: Scene) -> None:
    view = scene.train[0]
    camera = replace(view.camera, R=-view.camera.R, t=-view.camera.t)  # the other way: into the empty sky
    camera = replace(
        camera, R=np.diag([1.0, -1, -1]) @ view.camera.R, t=np.diag([1.0, -1, -1]) @ view.camera.t
    )
    photographs = Photographs(scene, scene.train, grey_mesh(scene), sources=3)
    base = torch.rand(3, camera.height, camera.width)
    gathered = photographs.gather(camera, base, look(scene.mesh, camera).depth)
    unseen = gathered.trust == 0
    exposed = photographs.exposure(camera).apply(base)
    assert torch.equal(gathered.blended()[:, unseen], exposed.half().float()[:, unseen])
    assert gathered.blended().isfinite().all()


def test_one_photograph_left_out_of_one_leaves_the_mesh(scene: Scene) -> None:
    view = scene.train[0]
    photographs = Photographs(scene, scene.train[:1], grey_mesh(scene), sources=2)
    gathered = gather(photographs, view.camera, {view.name})
    assert torch.equal(gathered.blended(), grey(view.camera))
    assert gathered.features().shape == (count_features(2), view.camera.height, view.camera.width)


def test_a_view_is_exposed_as_the_photographs_around_it(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photographs of a plain world, one side of the ring darker: each left-out view comes out as it was."""
    dark = {view.name for view in scene.train[:4]}

    def plain(self: Scene, view: View) -> np.ndarray:
        return np.full(
            (view.camera.height, view.camera.width, 3), 120 if view.name in dark else 130, np.uint8
        )

    monkeypatch.setattr(Scene, "load_image", plain)
    photographs = Photographs(scene, scene.train, grey_mesh(scene), 3)
    nothing = torch.full((3, 48, 64), 0.5)
    for view, level in ((scene.train[1], 120), (scene.train[-2], 130)):
        shown = photographs.exposure(view.camera, {view.name}).apply(nothing)
        torch.testing.assert_close(shown, torch.full_like(shown, level / 255), atol=2.5 / 255, rtol=0)


def test_a_small_cache_gives_the_same_picture(scene: Scene) -> None:
    camera = scene.test[0].camera
    pictures = []
    for cache in (4.0, 1e-9):
        photographs = Photographs(scene, scene.train, grey_mesh(scene), 3, cache_gib=cache)
        gather(photographs, scene.train[3].camera)
        pictures.append(gather(photographs, camera).blended())
    assert torch.equal(*pictures)


def test_colourings_do_not_see_each_other(scene: Scene) -> None:
    """Over a mesh in two colours at once, photographs show what they show over each of them alone."""
    view = scene.train[2]
    depth = look(scene.mesh, view.camera).depth

    def dark(camera: Camera) -> torch.Tensor:
        return 0.4 * grey(camera)

    def over(*colours: Callable[[Camera], torch.Tensor]) -> Photographs:
        def mesh(camera: Camera) -> tuple[list[torch.Tensor], torch.Tensor]:
            return [colour(camera) for colour in colours], look(scene.mesh, camera).depth

        return Photographs(scene, scene.train, mesh, 3)

    both, shown = over(grey, dark), []
    for i, colour in enumerate((grey, dark)):
        base = colour(view.camera)
        together = both.gather(view.camera, base, depth, {view.name}, colouring=i)
        alone = over(colour).gather(view.camera, base, depth, {view.name})
        assert all(torch.equal(getattr(together, f.name), getattr(alone, f.name)) for f in fields(Gathered))
        shown.append(together.shown)
    assert not torch.equal(*shown)


def test_masked_pixels_are_never_shown(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """With everything masked out, photographs show nothing."""
    monkeypatch.setattr(
        Scene, "load_mask", lambda self, view: np.zeros((view.camera.height, view.camera.width), bool)
    )
    camera = scene.test[0].camera
    photographs = Photographs(scene, scene.train, grey_mesh(scene), 3)
    assert torch.equal(gather(photographs, camera).blended(), grey(camera))


def test_the_network_starts_as_the_plain_blend(scene: Scene) -> None:
    renderer = Renderer(PRESETS["nmbg"].model, [scene.mesh])
    renderer.set_colours(mean_colours([scene.mesh]))
    renderer.remember(scene, scene.train)
    camera = scene.test[0].camera
    sight = renderer.see(camera)
    plain = sight.blended()[:, : camera.height, : camera.width]  # type: ignore[union-attr]
    torch.testing.assert_close(renderer(sight, camera), plain, atol=2e-3, rtol=0)


def test_a_network_shows_a_plain_frame_of_nothing(scene: Scene) -> None:
    """Its convolutions know where the frame ends, and would draw that."""
    renderer = Renderer(PRESETS["nmbg"].model, [scene.mesh])
    renderer.remember(scene, scene.train)
    torch.nn.init.normal_(renderer.network.layers[-1].weight)  # type: ignore[union-attr]
    camera = scene.test[0].camera
    away = 1e3 * scene.radius * np.ones(3)
    image = renderer.render(camera.looking_at(scene.centre + 2 * away, scene.centre + away, scene.up))
    assert image.flatten(1).std(1).max() == 0
    assert renderer.render(camera).flatten(1).std(1).min() > 0


def test_a_network_cannot_show_what_no_photograph_shows(scene: Scene) -> None:
    """Re-weighting alone leaves a pixel between its sources."""
    renderer = Renderer(PRESETS["nmbg"].model, [scene.mesh])
    renderer.remember(scene, scene.train)
    assert renderer.network is not None
    torch.nn.init.normal_(renderer.network.layers[-1].weight[3:], std=5.0)
    camera = scene.test[0].camera
    sight = renderer.see(camera)
    residual = renderer._fuse(sight) - sight.base.float()  # type: ignore[arg-type, union-attr]
    used = (sight.weights > 0)[:, None]  # type: ignore[union-attr]
    shown = sight.shown.float()  # type: ignore[union-attr]
    high = torch.where(used, shown, -torch.inf).amax(0).clamp(min=0)
    low = torch.where(used, shown, torch.inf).amin(0).clamp(max=0)
    assert ((residual <= high + 1e-3) & (residual >= low - 1e-3)).all()


def test_prepared_photographs_are_not_read_again(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    ready, small = (
        Photographs(scene, scene.train, grey_mesh(scene), sources=3, cache_gib=gib) for gib in (4.0, 1e-4)
    )
    expected = gather(ready, scene.test[0].camera).blended()
    ready.prepare()
    small.prepare()
    assert 0 < small.nbytes <= 1e-4 * 2**30 < ready.nbytes

    def unread(self: Scene, view: View) -> None:
        raise AssertionError(f"{view.name} is read")

    monkeypatch.setattr(Scene, "load_image", unread)
    assert torch.equal(gather(ready, scene.test[0].camera).blended(), expected)
    gather(ready, scene.test[1].camera)
    with pytest.raises(AssertionError, match="is read"):
        gather(small, scene.test[1].camera)
