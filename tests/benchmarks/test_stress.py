"""Each stress does what it says, by degrees, the same for the same seed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from stability import job_for
from stress import STRESSES, Stressed
from stress.geometry import parts

from nmbg.reconstruct.colours import mean_vertex_colours
from nmbg.scene import Scene


@pytest.fixture(scope="module")
def scene(scene_folder) -> Scene:
    return Scene.load(scene_folder)


def same(a: Scene, b: Scene) -> bool:
    arrays = [(getattr(a.mesh, name), getattr(b.mesh, name)) for name in ("vertices", "faces", "colours")]
    cameras = [
        (getattr(v.camera, name), getattr(w.camera, name))
        for v, w in zip(a.views, b.views, strict=False)
        for name in ("K", "R", "t")
    ]
    names = [[(v.name, v.image, v.split) for v in s.views] for s in (a, b)]
    return names[0] == names[1] and all(np.array_equal(x, y) for x, y in arrays + cameras)


def same_photographs(a: Stressed, b: Stressed, scene: Scene) -> bool:
    return all(np.array_equal(a.photograph(scene, v), b.photograph(scene, v)) for v in scene.views)


@pytest.mark.parametrize("name", STRESSES)
def test_nothing_changes_at_the_first_severity(scene, name):
    none = Stressed(STRESSES[name], STRESSES[name].severities[0])
    assert same(none.apply(scene), scene)
    assert all(np.array_equal(none.photograph(scene, v), scene.load_image(v)) for v in scene.views)


@pytest.mark.parametrize("name", [name for name, stress in STRESSES.items() if stress.changes])
def test_every_severity_changes_training_and_leaves_held_out_views_alone(scene, name):
    stress, worst = STRESSES[name], STRESSES[name].severities[-1]
    for severity in stress.severities[1:]:
        stressed, again = Stressed(stress, severity), Stressed(stress, severity)
        worse = stressed.apply(scene)
        assert same(worse, again.apply(scene))
        assert same_photographs(stressed, again, scene)
        if stress.image is None and severity == worst:
            assert not same(worse, scene)
        kept = {v.name: v for v in scene.test}
        assert {v.name for v in worse.test} == set(kept)
        for view in worse.test:
            assert view.camera is kept[view.name].camera
            shown, given = stressed.photograph(worse, view), scene.load_image(view)
            assert np.array_equal(shown, given) or stress.drifts
        if stress.drifts:
            changed = [
                v
                for v in scene.test
                if not np.array_equal(stressed.photograph(scene, v), scene.load_image(v))
            ]
            assert changed, "held-out photographs drift with those around them"


@pytest.mark.parametrize("name", [name for name in STRESSES if STRESSES[name].image is not None])
def test_photographs_get_worse_by_degrees(scene, name):
    def error(severity: float) -> float:
        stressed = Stressed(STRESSES[name], severity)
        return np.mean(
            [(stressed.photograph(scene, v).astype(float) - scene.load_image(v)) ** 2 for v in scene.train]
        )

    errors = [error(severity) for severity in STRESSES[name].severities]
    assert errors == sorted(errors)
    assert errors[0] == 0
    assert errors[-1] > 0  # these photographs are too small for the least blur


def test_vertices_are_dropped_and_cut_by_their_share(scene):
    n = len(parts(scene)[0].vertices)
    for name in ("vertices dropped", "regions cut"):
        for severity in STRESSES[name].severities[1:]:
            surface, shell = parts(Stressed(STRESSES[name], severity).apply(scene))
            gone = 1 - len(surface.vertices) / n
            assert severity - 0.05 < gone < severity + (0.05 if name == "vertices dropped" else 0.35)
            assert surface.faces.max(initial=-1) < len(surface.vertices)
            assert len(shell.vertices) == scene.shell_vertices


def test_jitter_has_its_deviation_and_is_alike_at_all_severities(scene):
    stress, (before, _) = STRESSES["jitter"], parts(scene)
    moves = [
        parts(Stressed(stress, severity).apply(scene))[0].vertices - before.vertices
        for severity in (0.01, 0.02)
    ]
    assert moves[0].std() == pytest.approx(0.01 * scene.radius, rel=0.1)
    np.testing.assert_allclose(moves[1], 2 * moves[0], atol=1e-4 * scene.radius)


def test_simplified_meshes_have_so_many_vertices_on_the_surface(scene):
    before, _ = parts(scene)
    for severity in (4, 16):
        after, _ = parts(Stressed(STRESSES["simplified"], severity).apply(scene))
        assert len(after.vertices) == pytest.approx(len(before.vertices) / severity, rel=0.3)
        assert (np.sort(after.faces, 1)[:, :-1] != np.sort(after.faces, 1)[:, 1:]).all()
        low, high = before.vertices.min(0) - 1e-5, before.vertices.max(0) + 1e-5
        assert ((after.vertices >= low) & (after.vertices <= high)).all()


def test_points_are_joined_with_neighbours_and_stay_where_they_are(scene):
    before, _ = parts(scene)
    after, _ = parts(Stressed(STRESSES["points only"], 2).apply(scene))
    assert np.array_equal(before.vertices, after.vertices)
    distance, _ = cKDTree(before.vertices).query(before.vertices, 4)
    corners = before.vertices[after.faces]
    reach = np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).max(1)
    assert (reach <= distance[after.faces[:, 0], 3] * (1 + 1e-5)).all()


def test_sheets_stand_before_the_surface_of_some_view(scene):
    before, _ = parts(scene)
    after, _ = parts(Stressed(STRESSES["floating sheets"], 3).apply(scene))
    added = after.vertices[len(before.vertices) :]
    assert len(added) == 3 * 144
    assert np.isfinite(added).all()
    for sheet in added.reshape(3, 144, 3):
        centre = sheet.mean(0)
        places = [v.camera.projection @ np.append(centre, 1) for v in scene.train]
        assert any(h[2] > 0 for h in places)


def test_cameras_are_off_by_what_is_said(scene_of_nine):
    scene = Scene.load(scene_of_nine)

    def pairs(name: str, severity: float):
        worse = Stressed(STRESSES[name], severity).apply(scene)
        return [(a.camera, b.camera) for a, b in zip(scene.train, worse.train, strict=True)]

    for a, b in pairs("rotation", 2):
        assert np.degrees(np.arccos((np.trace(a.R @ b.R.T) - 1) / 2)) == pytest.approx(2)
        np.testing.assert_allclose(a.centre, b.centre)
    for a, b in pairs("position", 0.05):
        assert np.linalg.norm(a.centre - b.centre) == pytest.approx(0.05 * scene.radius)
        np.testing.assert_allclose(a.R, b.R)
    for a, b in pairs("focal length", 0.1):
        assert b.K[0, 0] == pytest.approx(1.1 * a.K[0, 0])
        assert b.K[1, 1] == pytest.approx(1.1 * a.K[1, 1])
        np.testing.assert_array_equal(a.K[:, 2], b.K[:, 2])
    for a, b in pairs("principal point", 0.02):
        assert b.K[0, 2] - a.K[0, 2] == pytest.approx(0.02 * a.width)


def test_what_is_mended_is_the_same_damage(scene):
    for name, stress in STRESSES.items():
        if stress.mends is None:
            continue
        severity = stress.severities[-2]
        damaged = Stressed(STRESSES[stress.mends], severity).apply(scene)
        job = job_for(scene.folder, "photos", stress, severity)
        assert job.stressed is not None
        mended = job.stressed.apply(scene)
        surface, _ = parts(damaged)
        assert np.array_equal(mended.mesh.vertices[: len(surface.vertices)], surface.vertices), name
        for view, other in zip(damaged.views, mended.views, strict=True):
            np.testing.assert_array_equal(view.camera.projection, other.camera.projection)
        assert (job.config.refine == "poses") == ("refined" in name)
        assert (job.config.capacity == "auto") == ("sized" in name)
        assert (len(parts(mended)[0].faces) > len(surface.faces)) == ("closed" in name), name


def test_a_stressed_scene_is_written_and_read_back(scene, tmp_path):
    for name, severity in (("jitter", 0.01), ("noise", 25), ("wrong images", 0.4)):
        folder = tmp_path / name
        folder.mkdir()
        stressed = Stressed(STRESSES[name], severity, seed=1)
        written = stressed.write(scene, folder)
        again = Scene.load(folder)
        assert same(written, again)
        worse = stressed.apply(scene)
        for view, kept in zip(worse.views, again.views, strict=True):
            assert np.array_equal(again.load_image(kept), stressed.photograph(worse, view))


def test_views_beyond_the_cameras_are_those_that_the_tables_name(scene):
    """Of 49 views, held out as DTU's are; of another split nothing is judged."""
    stress = STRESSES["beyond"]
    assert stress.judged(scene, 0) == ()
    held_out = {0, 4, 13, 14, 15, 23, 24, 25, 38, 48}
    views = tuple(
        replace(scene.views[0], name=f"{i:02d}", split="test" if i in held_out else "train")
        for i in range(49)
    )
    dtu = replace(scene, views=views)
    assert stress.judged(dtu, 0) == ("13", "14", "15", "23", "24", "25")
    assert stress.judged(dtu, 1) == ("00", "04", "38", "48")
    assert job_for(Path("dtu"), "photos", stress, 1).stressed is None


@pytest.mark.parametrize(("name", "severity"), [("fewer views", 4), ("block", 0.75)])
def test_fewer_views_tell_nothing_of_what_only_the_others_saw(scene, name, severity):
    def seen(views):
        photographs = ((v.camera, scene.load_image(v), scene.load_mask(v)) for v in views)
        return mean_vertex_colours(scene.mesh, photographs)[1]

    names = {view.name for view in Stressed(STRESSES[name], severity).apply(scene).train}
    kept = seen([view for view in scene.train if view.name in names])
    before = seen(scene.train)
    assert (before & ~kept).any()
    colours = scene.mesh.colours.copy()
    colours[before] = (255, 0, 255)  # nothing in the photographs
    marked = replace(scene, mesh=replace(scene.mesh, colours=colours))
    found = Stressed(STRESSES[name], severity).apply(marked).mesh.colours
    assert not (found[before] == (255, 0, 255)).all(1).any()
    assert np.array_equal(found[~before], colours[~before])
