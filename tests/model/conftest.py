import numpy as np
import pytest

from nmbg.cameras import Camera
from nmbg.mesh import Mesh


@pytest.fixture
def camera() -> Camera:
    """A camera at (0, 0, −3) that looks at the origin."""
    K = np.array([[40.0, 0, 21.3], [0, 42.0, 15.2], [0, 0, 1]])
    return Camera(K, np.eye(3), np.array([0.0, 0, 3]), 43, 30)


@pytest.fixture
def bumpy() -> Mesh:
    """A jittered grid that covers the middle of the view, with random colours."""
    generator = np.random.default_rng(0)
    n = 12
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-0.8, 0.8, n))
    vertices = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3) + 0.02 * generator.standard_normal(
        (n * n, 3)
    )
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])
    colours = generator.integers(0, 256, (n * n, 3))
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), colours.astype(np.uint8))
