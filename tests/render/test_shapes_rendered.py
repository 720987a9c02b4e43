"""Shape models: their plates as SPICE meets them, spheres of plates against the analytic one, and shadows."""

import numpy as np
import pytest
import spiceypy

from opnav_workbench.errors import CameraError, KernelError
from opnav_workbench.geometry import rotation_from_vector, unit
from opnav_workbench.kernels import KernelSet
from opnav_workbench.kernels.dsk_files import write_dsk
from opnav_workbench.render import BodyModel, LommelSeeliger, ShapeModel
from opnav_workbench.render.shape import NO_PLATE, PlateSurface, bundle_axes, parallel_view, point_view

GOLDEN = (1.0 + 5.0**0.5) / 2.0


def icosphere(divisions):
    """Vertices on the unit sphere and plates: an icosahedron whose faces are divided into four, several times."""
    corners = [[s, t * GOLDEN, 0.0] for t in (1, -1) for s in (-1, 1)]
    vertices = unit(np.array([np.roll(c, k) for k in range(3) for c in corners]))
    near = np.linalg.norm(vertices[:, None] - vertices, axis=-1) < 1.2
    plates = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i)
            for k in range(j)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    for _ in range(divisions):
        a, b, c = (vertices[plates[:, k]] for k in range(3))
        n, m = len(vertices), len(plates)
        vertices = np.concatenate([vertices, unit(a + b), unit(b + c), unit(c + a)])
        ab, bc, ca = n + np.arange(m), n + m + np.arange(m), n + 2 * m + np.arange(m)
        i, j, k = plates.T
        plates = np.concatenate(
            [np.stack(t, axis=-1) for t in ((i, ab, ca), (ab, j, bc), (ca, bc, k), (ab, bc, ca))]
        )
    a, b, c = (vertices[plates[:, k]] for k in range(3))
    inward = np.sum(np.cross(b - a, c - a) * (a + b + c), axis=1) < 0.0
    plates[inward] = plates[inward][:, ::-1]
    return vertices, plates


def lumpy(divisions=4):
    """A body with hills that hide and shade each other."""
    vertices, plates = icosphere(divisions)
    hills = (
        np.sin(7.0 * vertices[:, 0]) * np.cos(5.0 * vertices[:, 1] + 1.0) * np.sin(6.0 * vertices[:, 2] + 0.4)
    )
    return vertices * (1.0 + 0.25 * hills)[:, None] * 100.0, plates


def test_plates_are_met_where_spice_meets_them(tmp_path):
    vertices, plates = lumpy()
    write_dsk(tmp_path / "lumpy.bds", vertices, plates, 999, "IAU_PLUTO")
    shape = ShapeModel(vertices, plates)
    camera = np.array([700.0, -300.0, 250.0])
    rng = np.random.default_rng(11)
    rays = (rng.uniform(-130.0, 130.0, (3000, 3)) - camera).T
    surface = PlateSurface(shape, camera, np.array([1e8, 2e7, -3e7]))
    met = surface.first_hits(rays)
    with KernelSet(tmp_path / "lumpy.bds"):
        places, found = spiceypy.dskxv(
            False, "PLUTO", [], 0.0, "IAU_PLUTO", np.tile(camera, (3000, 1)), np.ascontiguousarray(rays.T)
        )
        normals = spiceypy.srfnrm("DSK/UNPRIORITIZED", "PLUTO", 0.0, "IAU_PLUTO", np.asarray(places)[met.ray])
        sunward = unit(np.array([1e8, 2e7, -3e7]))
        lit = surface.sunlit(met.point)
        _, shaded = spiceypy.dskxv(
            False, "PLUTO", [], 0.0, "IAU_PLUTO", np.ascontiguousarray(met.point.T + 1e-6 * met.normal.T),
            np.tile(sunward, (len(met.ray), 1)),
        )  # fmt: skip
    np.testing.assert_array_equal(np.flatnonzero(found), met.ray)
    np.testing.assert_allclose(met.point.T, np.asarray(places)[met.ray], atol=1e-9)
    np.testing.assert_allclose(met.normal.T, normals, atol=1e-9)
    facing = sunward @ met.normal > 1e-3
    assert (facing & ~lit).sum() > 100  # hills shade what faces the Sun
    np.testing.assert_array_equal(lit[facing], ~np.asarray(shaded, bool)[facing])


def test_rays_along_edges_do_not_slip_through():
    vertices, plates = icosphere(2)
    view = point_view(vertices, plates, np.array([0.0, 0.0, 5.0]), bundle_axes(np.array([0.0, 0.0, -1.0])))
    corner = (vertices - [0.0, 0.0, 5.0]) @ bundle_axes(np.array([0.0, 0.0, -1.0]))
    uv = (corner[:, :2] / corner[:, 2:]).T
    inner = np.hypot(*uv) < 0.9 * np.hypot(*uv).max()
    assert np.all(view.first_met(uv[:, inner])[0] != NO_PLATE)
    outside = view.first_met(np.array([[9.0, np.inf, -9.0], [0.0, np.inf, 0.0]]))
    assert np.all(outside[0] == NO_PLATE)
    down = parallel_view(vertices, plates, np.eye(3))
    height = down.first_met(np.zeros((2, 1)))[1]
    assert height[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow(keep=["70.0"])
@pytest.mark.parametrize("phase_deg", [0.0, 70.0])
def test_spheres_of_plates_approach_the_sphere(stage, phase_deg):
    target = stage.target(60.0, phase_deg)
    exact = stage.render(BodyModel(target, LommelSeeliger()))
    errors, fluxes = [], []
    for divisions in (3, 4, 5):
        vertices, plates = icosphere(divisions)
        volume = ShapeModel(vertices, plates).volume_km3
        scale = target.radii_km[0] * (4.0 * np.pi / 3.0 / volume) ** (1.0 / 3.0)  # of the sphere's volume
        rendering = stage.render(
            BodyModel(target, LommelSeeliger(), shape=ShapeModel(vertices * scale, plates))
        )
        difference = rendering.electrons - exact.electrons
        errors.append(np.sqrt(np.mean(difference[exact.electrons > 0.0] ** 2)) / exact.electrons.max())
        fluxes.append(abs(rendering.bodies[0].flux_e / exact.bodies[0].flux_e - 1.0))
        assert rendering.electrons.sum() == pytest.approx(rendering.bodies[0].flux_e, rel=3e-3)
    assert errors[0] > 1.5 * errors[1]
    assert max(errors[1:]) < 0.003  # what a surface of plates is sampled to
    assert fluxes[2] < 3e-3
    np.testing.assert_allclose(rendering.bodies[0].light_px, exact.bodies[0].light_px, atol=0.05)


def test_a_hill_throws_its_shadow(stage):
    # A square tower on a slab, the Sun 45 deg high: the shadow is as long as the tower is high.
    def box(low, high):
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        plates = [t for f in faces for t in ((f[0], f[1], f[2]), (f[0], f[2], f[3]))]
        return np.array(low) + corners * (np.array(high) - np.array(low)), np.array(plates)

    slab, plates = box([-50, -50, -10], [50, 50, 0])
    tower, more = box([-5, -5, 0], [5, 5, 20])
    shape = ShapeModel(np.concatenate([slab, tower]), np.concatenate([plates, more + 8]))
    surface = PlateSurface(shape, np.array([0.0, 0.0, 1e4]), np.array([1e8, 0.0, 1e8]))
    x = np.linspace(-49.0, 49.0, 99) + 0.013
    points = np.stack([x, np.full(99, 0.1), np.zeros(99)])
    dark = ~surface.sunlit(points)
    outside = np.abs(x) > 5.0
    np.testing.assert_array_equal(dark[outside], ((x > -25.0) & (x < -5.0))[outside])


@pytest.mark.slow
def test_a_moon_of_plates_hides_and_shades_like_a_round_one(stage):
    planet = stage.model(60.0, 40.0, LommelSeeliger())
    sunward, toward = unit(planet.target.sun_position_km), unit(planet.target.position_km)
    radius = planet.target.radii_km[0]
    for offset in (8.0 * radius * sunward, -8.0 * radius * toward):
        moon = stage.target(60.0, 40.0, name="MOON")
        position = planet.target.position_km + offset
        round_moon = type(moon)(
            "MOON", position, radii_km=0.3 * moon.radii_km, body_from_j2000=np.eye(3),
            sun_position_km=moon.sun_position_km,
        )  # fmt: skip
        vertices, plates = icosphere(5)
        plated = ShapeModel(0.3 * radius * vertices, plates)
        a = stage.render(planet, BodyModel(round_moon, LommelSeeliger(), 0.2))
        b = stage.render(planet, BodyModel(round_moon, LommelSeeliger(), 0.2, shape=plated))
        assert b.electrons.sum() == pytest.approx(a.electrons.sum(), rel=2e-3)
        # A shape's shadow has no penumbra: that of the round moon is 0.06 px wide here.
        np.testing.assert_allclose(b.electrons, a.electrons, atol=0.08 * a.electrons.max())


def test_shapes_are_turned_outward_and_checked():
    vertices, plates = icosphere(1)
    inside_out = ShapeModel(vertices, plates[:, ::-1])
    assert inside_out.volume_km3 > 0.0
    with pytest.raises(KernelError, match="empty"):
        ShapeModel(np.empty((0, 3)), np.empty((0, 3), int))
    with pytest.raises(KernelError, match=r"plate 3 refers to vertices .* go from 0 to 71"):
        ShapeModel(vertices, np.where(np.arange(80)[:, None] == 3, 72, plates))
    with pytest.raises(CameraError, match="must stand outside"):
        PlateSurface(inside_out, np.array([0.5, 0.0, 0.0]), np.array([1e8, 0.0, 0.0]))


@pytest.mark.realdata
def test_bennu_with_its_shadows(stage, data_dir):
    shape = ShapeModel.from_file(data_dir / "shapes" / "bennu.cmod")
    assert len(shape.plates) == 49152
    # Published: 0.0615 km^3 (Barnouin et al. 2019), 565 x 535 x 508 m.
    assert shape.volume_km3 == pytest.approx(0.0615, rel=0.01)
    np.testing.assert_allclose(2e3 * shape.radii_km, [565.0, 535.0, 508.0], atol=15.0)
    target = stage.target(100.0, 80.0)
    small = type(target)(
        "BENNU", target.position_km * 0.25 / 1188.3, radii_km=shape.radii_km,
        body_from_j2000=rotation_from_vector(np.array([0.3, 0.2, 0.1])), sun_position_km=target.sun_position_km,
    )  # fmt: skip
    with_it = stage.render(BodyModel(small, LommelSeeliger(), shape=shape))
    without = stage.render(BodyModel(small, LommelSeeliger()))
    assert with_it.bodies[0].flux_e == pytest.approx(without.bodies[0].flux_e, rel=0.15)
    assert with_it.electrons.sum() == pytest.approx(with_it.bodies[0].flux_e, rel=5e-3)
