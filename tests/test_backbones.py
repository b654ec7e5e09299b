"""Feature networks: structure, where weights are found, and what is said when they are not."""

import urllib.error
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F

from nmbg.backbones import NETS, POOLS, find_heads, find_weights, hub_cache, installed_weights, load_features
from nmbg.errors import NmbgError

# torchvision's documented parameter counts, less those of its classifiers.
FEATURE_PARAMETERS = {
    "vgg16": 138_357_544 - (25_088 * 4096 + 4096) - (4096 * 4096 + 4096) - (4096 * 1000 + 1000),
    "vgg19": 143_667_240 - (25_088 * 4096 + 4096) - (4096 * 4096 + 4096) - (4096 * 1000 + 1000),
    "alexnet": 61_100_840 - (9216 * 4096 + 4096) - (4096 * 4096 + 4096) - (4096 * 1000 + 1000),
    "squeezenet1_1": 1_235_496 - (512 * 1000 + 1000),
}


@pytest.fixture(autouse=True)
def offline(tmp_path_factory, monkeypatch):
    """An empty hub cache and no network."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path_factory.mktemp("hub")))

    def refuse(*args, **kwargs):
        raise urllib.error.URLError("no route to host")

    monkeypatch.setattr(torch.hub, "download_url_to_file", refuse)


def random_checkpoint(net: str, layer: str | None = None) -> dict[str, torch.Tensor]:
    """Random weights of the whole network, or up to `layer`, under torchvision's names."""
    stack = NETS[net].build(POOLS["max"])
    count = len(stack.modules) if layer is None else stack.layers[layer]
    return {f"features.{k}": v for k, v in torch.nn.Sequential(*stack.modules[:count]).state_dict().items()}


def one_line(error: pytest.ExceptionInfo[NmbgError]) -> str:
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("net", NETS)
def test_parameter_count_is_torchvisions(net):
    with torch.device("meta"):
        stack = NETS[net].build(POOLS["max"])
    assert sum(p.numel() for m in stack.modules for p in m.parameters()) == FEATURE_PARAMETERS[net]


@pytest.mark.parametrize(
    ("net", "key", "shape"),
    [
        ("vgg19", "features.34.weight", (512, 512, 3, 3)),
        ("vgg16", "features.28.weight", (512, 512, 3, 3)),
        ("alexnet", "features.10.bias", (256,)),
        ("squeezenet1_1", "features.12.expand3x3.weight", (256, 64, 3, 3)),
        ("squeezenet1_1", "features.9.squeeze.weight", (48, 256, 1, 1)),
    ],
)
def test_parameter_names_are_torchvisions(net, key, shape):
    assert random_checkpoint(net)[key].shape == shape


@pytest.mark.parametrize(
    ("net", "layers", "shapes"),
    [
        ("vgg19", ("relu1_2", "relu3_1"), [(64, 64, 48), (256, 16, 12)]),
        ("alexnet", ("relu1", "relu2", "relu5"), [(64, 15, 11), (192, 7, 5), (256, 3, 2)]),
        ("squeezenet1_1", ("relu1", "fire3", "fire9"), [(64, 31, 23), (128, 15, 11), (512, 3, 2)]),
    ],
)
def test_feature_shapes(tmp_path, net, layers, shapes):
    torch.save(random_checkpoint(net), tmp_path / NETS[net].file)
    features = load_features(net, layers, tmp_path)
    assert [tuple(f.shape[1:]) for f in features(torch.rand(2, 3, 64, 48))] == shapes


def test_layers_come_in_the_order_asked(tmp_path):
    torch.save(random_checkpoint("vgg19", "relu2_1"), tmp_path / "vgg19-first.pth")
    late, early = load_features("vgg19", ("relu2_1", "relu1_1"), tmp_path)(torch.rand(1, 3, 8, 8))
    assert late.shape[1] == 128
    assert early.shape[1] == 64


def test_first_layer_is_convolution_of_the_normalised_image(tmp_path):
    checkpoint = random_checkpoint("vgg19", "relu1_1")
    torch.save(checkpoint, tmp_path / NETS["vgg19"].file)
    image = torch.rand(1, 3, 9, 7)
    mean = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
    std = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    expected = F.conv2d(
        (image - mean) / std, checkpoint["features.0.weight"], checkpoint["features.0.bias"], padding=1
    ).relu()
    (feature,) = load_features("vgg19", ["relu1_1"], tmp_path)(image)
    torch.testing.assert_close(feature, expected)


@pytest.mark.parametrize("pooling", ["max", "average"])
def test_pooling_between_blocks(tmp_path, pooling):
    torch.save(random_checkpoint("vgg19", "relu2_1"), tmp_path / NETS["vgg19"].file)
    features = load_features("vgg19", ["relu1_2", "relu2_1"], tmp_path, pooling)
    before, after = features(torch.rand(1, 3, 8, 6))
    pooled = F.max_pool2d(before, 2) if pooling == "max" else F.avg_pool2d(before, 2)
    torch.testing.assert_close(after, features.features[5](pooled).relu())


def test_network_is_frozen_and_whole(tmp_path):
    torch.save(random_checkpoint("alexnet"), tmp_path / NETS["alexnet"].file)
    features = load_features("alexnet", ["relu2"], tmp_path)
    assert not features.training
    assert not any(p.requires_grad for p in features.parameters())
    assert not any(p.is_meta for p in features.parameters())


def test_half_precision_checkpoint_is_read_as_float32(tmp_path):
    halves = {key: value.half() for key, value in random_checkpoint("vgg19", "relu1_1").items()}
    torch.save(halves, tmp_path / "vgg19_half.pth")
    assert all(p.dtype == torch.float32 for p in load_features("vgg19", ["relu1_1"], tmp_path).parameters())


def test_truncated_checkpoint_serves_the_layers_it_holds(tmp_path):
    path = tmp_path / "vgg19_conv1_1-conv3_1.pth"
    torch.save(random_checkpoint("vgg19", "relu3_1"), path)
    load_features("vgg19", ["relu1_2", "relu3_1"], tmp_path)
    with pytest.raises(NmbgError) as error:
        load_features("vgg19", ["relu1_2", "relu4_2"], tmp_path)
    message = one_line(error)
    for part in (
        str(path),
        "features.12.weight",
        "relu3_2",
        "up to relu3_1",
        "--weights",
        "--perceptual none",
    ):
        assert part in message


def test_tensor_of_another_shape_is_refused(tmp_path):
    checkpoint = random_checkpoint("vgg19", "relu1_1")
    checkpoint["features.0.weight"] = checkpoint["features.0.weight"][:32]
    torch.save(checkpoint, tmp_path / "vgg19.pth")
    with pytest.raises(NmbgError, match=r"vgg19.pth: holds features.0.weight of shape \[32, 3, 3, 3\]"):
        load_features("vgg19", ["relu1_1"], tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04 cut off"])
def test_damaged_file_is_named(tmp_path, content):
    (tmp_path / NETS["vgg19"].file).write_bytes(content)
    with pytest.raises(NmbgError) as error:
        load_features("vgg19", ["relu1_1"], tmp_path)
    assert f"{tmp_path / NETS['vgg19'].file}: not a readable checkpoint" in one_line(error)


def test_file_cut_short_is_named(tmp_path):
    path = tmp_path / NETS["vgg19"].file
    torch.save(random_checkpoint("vgg19", "relu1_1"), path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(NmbgError, match="not a readable checkpoint"):
        load_features("vgg19", ["relu1_1"], tmp_path)


def test_pickled_code_is_not_run(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "trapped",))

    torch.save({"features.0.weight": Trap()}, tmp_path / NETS["vgg19"].file)
    with pytest.raises(NmbgError, match="not a readable checkpoint"):
        load_features("vgg19", ["relu1_1"], tmp_path)
    assert not (tmp_path / "trapped").exists()


def test_something_else_than_a_state_dict_is_refused(tmp_path):
    torch.save([1, 2, 3], tmp_path / NETS["vgg19"].file)
    with pytest.raises(NmbgError, match="not a state dict"):
        load_features("vgg19", ["relu1_1"], tmp_path)


@pytest.mark.parametrize(
    ("net", "otherwise"), [("vgg19", "--perceptual none"), ("alexnet", "leave lpips out of --metrics")]
)
def test_missing_weights_say_what_where_and_how_else(tmp_path, net, otherwise):
    with pytest.raises(NmbgError) as error:
        find_weights(net, tmp_path)
    message = one_line(error)
    for part in (NETS[net].file, str(tmp_path), "no route to host", "https://", "--weights", otherwise):
        assert part in message


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(NmbgError, match=r"nowhere: no such folder; --weights"):
        find_weights("vgg19", tmp_path / "nowhere")


def test_unknown_layer_lists_the_known():
    with pytest.raises(NmbgError, match=r"vgg19 has no layer conv9; choose from relu1_1, relu1_2"):
        load_features("vgg19", ["conv9"])


def test_folder_goes_before_cache_and_cache_before_download(tmp_path, monkeypatch):
    cache = tmp_path / "hub"
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(cache))
    downloads = []

    def download(url, destination, hash_prefix):
        downloads.append((url, hash_prefix))
        Path(destination).write_bytes(b"downloaded")

    monkeypatch.setattr(torch.hub, "download_url_to_file", download)
    folder = tmp_path / "mine"
    folder.mkdir()
    assert installed_weights("vgg16", folder) is None

    fetched = find_weights("vgg16", folder)
    assert fetched == hub_cache() / "vgg16-397923af.pth" == cache / "checkpoints" / "vgg16-397923af.pth"
    assert downloads == [("https://download.pytorch.org/models/vgg16-397923af.pth", "397923af")]
    assert find_weights("vgg16", folder) == fetched
    assert len(downloads) == 1

    own = folder / "vgg16-397923af.pth"
    own.write_bytes(b"")
    assert find_weights("vgg16", folder) == own


def test_other_names_count_but_not_other_networks(tmp_path):
    (tmp_path / "vgg19_bn-c79401a0.pth").write_bytes(b"another network")
    assert installed_weights("vgg19", tmp_path) is None
    (tmp_path / "vgg19_conv1_1.pth").write_bytes(b"short")
    (tmp_path / "vgg19_all.pth").write_bytes(b"longer")
    assert installed_weights("vgg19", tmp_path) == tmp_path / "vgg19_all.pth"
    (tmp_path / NETS["vgg19"].file).write_bytes(b"")
    assert installed_weights("vgg19", tmp_path) == tmp_path / NETS["vgg19"].file


def test_heads_come_from_the_folder_or_from_torchmetrics(tmp_path, monkeypatch):
    assert find_heads("alex", tmp_path).parent.name == "lpips_models"
    (tmp_path / "lpips").mkdir()
    (tmp_path / "lpips" / "alex.pth").write_bytes(b"")
    assert find_heads("alex", tmp_path) == tmp_path / "lpips" / "alex.pth"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(NmbgError, match=r"lpips/squeeze.pth: not found; get https://.*--weights"):
        find_heads("squeeze", tmp_path)


def test_image_of_another_shape_is_refused(tmp_path):
    torch.save(random_checkpoint("vgg19", "relu1_1"), tmp_path / NETS["vgg19"].file)
    with pytest.raises(ValueError, match=r"\[B, 3, H, W\], got \[3, 8, 8\]"):
        load_features("vgg19", ["relu1_1"], tmp_path)(torch.rand(3, 8, 8))
