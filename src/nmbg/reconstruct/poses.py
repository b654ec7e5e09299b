"""Moving the training cameras to where their photographs agree with what the others show.

Colours are fitted to the mesh from all photographs; each photograph is then aligned, by Gauss-Newton steps
over the six parameters of its pose, with those colours as they are without it (in folds), as direct image
alignment does. What all cameras do together is undone after each round: it would move the scene, not improve
it. For poses that are rough: a bundle adjustment knows better than the colours on a mesh can tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from scipy.spatial.transform import Rotation
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.images import from_bytes, resize
from nmbg.model.config import ModelConfig
from nmbg.model.exposure import fit_exposure
from nmbg.model.fragments import rasterize_finest
from nmbg.model.renderer import Renderer
from nmbg.progress import console, progress_bar
from nmbg.reconstruct.coverage import mask_at
from nmbg.scene import Scene, View
from nmbg.training.start import ColourFit

# Longer side of the images that are aligned, pixels, and how often they are.
SIZE = 480
FOLDS = 4
# Colours that differ by more count as of this difference: they show something else.
ROBUST = 0.05
# Rounds of alignment, and in each how many 3 × 3 means are taken over photograph and colours: their gradients
# reach as far. What is left of rough poses in the end takes sharp images to see.
BLURS = (2, 2, 2, 2, 1, 1, 1, 0, 0, 0)
# Neighbouring pixels whose depths differ by this factor stand on an outline, which moves with the geometry.
JUMP = 1.05
# How far given poses may be off: an angle, and a share of the foreground sphere's radius. To be as far away
# costs as much as colours that differ by PRIOR more on average: what the photographs hardly tell, as a turn
# from a step aside before a distant surface, stays as it was given.
ANGLE, DISTANCE, PRIOR = np.radians(0.2), 0.005, 0.0004
# Poses that are sound to within so many pixels of these images are better than what alignment finds: on true
# poses it moved what is seen by 0.23 pixels, and new views lost 0.2 to 0.7 dB.
LEAST_SHIFT = 0.5
# So many pixels at least tell six parameters.
LEAST_PIXELS = 500

Array = npt.NDArray[np.float64]

_COLOURS = ModelConfig(degree=1, features=3, points=False, widths=())


def refine_poses(scene: Scene, blurs: Sequence[int] = BLURS) -> Scene:
    """The scene with the poses of its training views refined, where these are rough.

    The held-out views stay as they are.

    Args:
        scene: only its training views are read.
        blurs: of each round of alignment, how often photograph and colours are smoothed.
    """
    given = views = {view.name: view for view in scene.train}
    if len(views) < FOLDS:
        return scene
    with progress_bar() as bar:
        for blur in bar.track(blurs, description="refining poses"):
            views = _round(scene, views, blur)
    shift = float(np.median([_shift(scene, given[name].camera, views[name].camera) for name in views]))
    if shift < LEAST_SHIFT:
        console.print(f"the poses stay as they are: refining them moves what is seen by {shift:.2f} pixels")
        return scene
    moved = tuple(views.get(view.name, view) for view in scene.views)
    return replace(scene, views=moved)


def _shift(scene: Scene, before: Camera, after: Camera) -> float:
    """How far the surface moves in a view between two poses of it: a mean, in pixels of an image of SIZE."""
    points = torch.from_numpy(scene.mesh.vertices).double()
    old, new = before.project(points), after.project(points)
    u, v = (h[:, :2] / h[:, 2:] for h in (old, new))
    size = torch.tensor([before.width, before.height])
    inside = (old[:, 2] > 0) & (new[:, 2] > 0) & (u >= 0).all(1) & (u <= size).all(1)
    moved = (u - v)[inside].norm(dim=1) * min(1.0, SIZE / float(size.max()))
    return float(moved.mean()) if len(moved) else 0.0


def _round(scene: Scene, views: dict[str, View], blur: int) -> dict[str, View]:
    fit = ColourFit([scene.mesh], scene, list(views.values()), _COLOURS.bases, FOLDS, quiet=True)
    renderers = []
    for fold in range(FOLDS):
        renderers.append(Renderer(_COLOURS, [scene.mesh]))
        renderers[-1].set_colours(fit.coefficients(without=fold))
    aligned = {
        view.name: _aligned(scene, views[view.name], view.camera, renderers[fit.fold_of(view)], blur)
        for view in scene.train
    }
    before = [view.camera for view in views.values()]
    after = without_common_motion(before, list(aligned.values()))
    return {name: replace(view, camera=c) for (name, view), c in zip(views.items(), after, strict=True)}


@torch.no_grad()
def _aligned(scene: Scene, view: View, given: Camera, colours: Renderer, blur: int) -> Camera:
    """The view's camera after one Gauss-Newton step; `given` is the one that it began with."""
    small = view.camera.within(SIZE)
    image = from_bytes(resize(scene.load_image(view), small.width, small.height))
    fragments = rasterize_finest(scene.mesh, small, _COLOURS)
    depth, face = fragments.depth, fragments.levels[0].face
    assert depth is not None
    assert face is not None
    colour = colours.colour([fragments], small)
    counted = torch.from_numpy(mask_at(scene.load_mask(view), small)) & (face >= 0)
    image = _blurred(fit_exposure(image, colour, counted).undo(image), blur)
    counted &= _smooth(depth)
    moved = np.concatenate(
        [
            Rotation.from_matrix(view.camera.R @ given.R.T).as_rotvec(),
            view.camera.t - view.camera.R @ given.R.T @ given.t,
        ]
    )
    doubt = PRIOR / np.repeat([ANGLE, DISTANCE * scene.radius], 3) ** 2
    twist = _step(small, image, _blurred(colour, blur), depth, counted, doubt, moved)
    turn = Rotation.from_rotvec(twist[:3]).as_matrix()
    return replace(view.camera, R=turn @ view.camera.R, t=turn @ view.camera.t + twist[3:])


def _step(
    camera: Camera, image: Tensor, colour: Tensor, depth: Tensor, counted: Tensor, doubt: Array, moved: Array
) -> Array:
    """Rotation vector and translation [6], in the camera's frame, that bring the image nearer to the colours.

    Args:
        camera: of both.
        image: [3, H, W] what the photograph shows.
        colour: [3, H, W] what it should show.
        depth: [H, W] view-space z.
        counted: [H, W] bool, pixels that count.
        doubt: [6], what it costs to move away from the pose that was given.
        moved: [6], how far it has been moved already.
    """
    inner = torch.zeros_like(counted)
    inner[1:-1, 1:-1] = counted[1:-1, 1:-1]
    if int(inner.sum()) < LEAST_PIXELS:
        return np.zeros(6)
    gradient_y, gradient_x = (g[:, inner].double() for g in torch.gradient(image, dim=(1, 2)))
    rows, columns = inner.nonzero(as_tuple=True)
    z = depth[inner].double()
    K = camera.K
    x, y = (columns + 0.5 - K[0, 2]) / K[0, 0], (rows + 0.5 - K[1, 2]) / K[1, 1]
    # How the pixel of a surface point moves with (ω, v): X' = X + ω × X + v, u = f X / Z + c.
    one, zero = torch.ones_like(z), torch.zeros_like(z)
    du = K[0, 0] * torch.stack([-x * y, one + x * x, -y, one / z, zero, -x / z])
    dv = K[1, 1] * torch.stack([-(one + y * y), x * y, x, zero, one / z, -y / z])
    J = gradient_x[:, None] * du + gradient_y[:, None] * dv  # [3, 6, pixels]
    residual = (image - colour)[:, inner].double()
    weight = 1 / residual.abs().clamp(min=ROBUST)
    normal = (torch.einsum("cip,cp,cjp->ij", J, weight, J) / weight.numel()).numpy()
    rhs = (torch.einsum("cip,cp,cp->i", J, weight, residual) / weight.numel()).numpy()
    twist: Array = -np.linalg.solve(normal + np.diag(doubt), rhs + doubt * moved)
    return twist


def _blurred(image: Tensor, times: int) -> Tensor:
    for _ in range(times):
        image = F.avg_pool2d(image[None], 3, 1, 1, count_include_pad=False)[0]
    return image


def _smooth(depth: Tensor) -> Tensor:
    """Pixels around which the depth does not jump, [H, W] bool."""
    largest = F.max_pool2d(depth[None], 3, 1, 1)[0]
    smallest = -F.max_pool2d(-depth[None], 3, 1, 1)[0]
    return (smallest > 0) & (largest < JUMP * smallest)


def without_common_motion(before: Sequence[Camera], after: Sequence[Camera]) -> list[Camera]:
    """Cameras `after`, less the rigid motion that brings those `before` nearest to them."""
    centres = np.stack([camera.centre for camera in before])
    reach = max(float(np.linalg.norm(centres - centres.mean(0), axis=1).mean()), 1e-12)
    old, new = (
        np.concatenate([[c.centre, *(c.centre + reach * c.R)] for c in cameras])
        for cameras in (before, after)
    )
    turn, _ = Rotation.align_vectors(new - new.mean(0), old - old.mean(0))
    common = turn.as_matrix()
    shift = new.mean(0) - common @ old.mean(0)
    # World points x move to common x + shift with all cameras: moving them back is x ↦ commonᵀ (x − shift).
    return [replace(camera, R=camera.R @ common, t=camera.R @ shift + camera.t) for camera in after]
