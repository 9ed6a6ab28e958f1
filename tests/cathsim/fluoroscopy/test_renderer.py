"""The drawn wire: where it lies, how dark it is, and that its mask has no gap."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import ndimage

from cathsim.fluoroscopy import FluoroscopyRenderer, Projector, quantum_noise

BOUNDS = np.array([[-0.06, -0.04, -0.11], [0.06, 0.04, 0.11]])
EIGHT = np.ones((3, 3))


def make(size=80, level=180.0, view="frontal", **options):
    projector = Projector.view(view, BOUNDS, size)
    return FluoroscopyRenderer(projector, np.full((projector.height, projector.width), level), **options)


def random_wire(seed, nodes=28, link=0.009):
    """A wandering wire inside the field, links like those of the simulator."""
    generator = np.random.default_rng(seed)
    heading = generator.normal(size=3)
    points = [generator.uniform(BOUNDS[0] / 2, BOUNDS[1] / 2)]
    for _ in range(nodes - 1):
        heading += 0.35 * generator.normal(size=3) - 0.35 * points[-1] / 0.06
        heading /= np.linalg.norm(heading)
        points.append(points[-1] + link * heading)
    return np.array(points)


def straight_wire(start, end, nodes=20):
    return np.linspace(start, end, nodes)


@pytest.mark.parametrize("size", [80, 128])
def test_mask_has_no_gap(size):
    renderer, whole = make(size), 0
    for seed in range(150):
        wire = random_wire(seed)
        mask = renderer.mask(wire)
        pixels = renderer.projector.project(wire)
        if (pixels < 0).any() or (pixels > size - 1).any():
            continue
        whole += 1
        assert ndimage.label(mask, EIGHT)[1] == 1
        for axis, covered in ((0, mask.any(axis=0)), (1, mask.any(axis=1))):
            low, high = np.rint([pixels[:, axis].min(), pixels[:, axis].max()]).astype(int)
            assert covered[low : high + 1].all()
        nearest = np.rint(pixels).astype(int)
        assert mask[nearest[:, 1], nearest[:, 0]].all()
    assert whole > 100  # the others leave the image


def test_mask_is_thin_and_every_pixel_of_it_is_darkened():
    renderer = make(80)
    wire = random_wire(3)
    image, mask = renderer.render(wire), renderer.mask(wire)
    assert set(np.unique(mask)) == {0, 1}
    assert (image[mask == 1] < 170).all()
    length = np.linalg.norm(np.diff(renderer.projector.project(wire), axis=0), axis=1).sum()
    assert mask.sum() < 1.8 * length
    assert (image != 180).sum() < 3.2 * length


def test_away_from_the_wire_the_image_is_the_background():
    grey = np.random.default_rng(0).uniform(20, 230, (80, 80))
    renderer = FluoroscopyRenderer(Projector.frontal(BOUNDS, 80), grey)
    wire = random_wire(5)
    image = renderer.render(wire)
    far = ndimage.distance_transform_cdt(renderer.mask(wire) == 0, "chessboard") > 2
    np.testing.assert_array_equal(image[far], np.rint(grey).astype(np.uint8)[far])
    assert (image <= np.rint(grey)).all()


def test_wire_attenuates_as_a_cylinder_when_the_image_resolves_it():
    renderer = make(1024, level=200.0, wire_radius=1e-3, wire_attenuation=1000.0, gamma=0.5)
    width = renderer.wire_width_px
    assert width == pytest.approx(2e-3 * renderer.projector.pixels_per_metre([0, 0, 0]))
    image = renderer.render(straight_wire([0, 0, -0.05], [0, 0, 0.05]))
    row = image[512].astype(float)
    centre = (renderer.projector.width - 1) / 2
    for column in range(512, 512 + int(width / 2)):
        edges = np.clip((column - centre + np.linspace(-0.5, 0.5, 201)) / (width / 2), -1, 1)
        chord = 2e-3 * np.sqrt(1 - edges**2).mean()
        assert row[column] == pytest.approx(200 * np.exp(-0.5 * 1000.0 * chord), abs=1.5)
    assert row[512 + int(width / 2) + 2] == 200


def test_thin_wire_is_drawn_at_least_1_2_px_wide():
    assert make(80).wire_width_px == pytest.approx(1.2)
    assert make(80, wire_radius=1e-5).wire_width_px == pytest.approx(1.2)
    image = make(80).render(straight_wire([0.001, 0, -0.05], [0.02, 0, 0.06]))
    rows = image[30:50].min(axis=1)
    assert rows.max() < 100  # the wire darkens every row, whatever the position between pixels


@pytest.mark.parametrize("links", [[0.016] * 9, [0.004] * 6 + [0.016] * 8, [0.003, 0.017] * 7])
def test_long_links_are_drawn_as_a_smooth_curve(links):
    renderer = make(512)
    radius = 0.03
    angle = np.concatenate([[0], np.cumsum(links)]) / radius
    coarse = radius * np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    fine_angle = np.linspace(0, angle[-1], 600)
    fine = radius * np.column_stack([np.cos(fine_angle), 0 * fine_angle, np.sin(fine_angle)])
    drawn, truth = renderer.mask(coarse), renderer.mask(fine)
    away = ndimage.distance_transform_edt(truth == 0)
    assert away[drawn == 1].max() < 1.5  # a polyline would miss the arc by 2.6 px
    assert ndimage.distance_transform_edt(drawn == 0)[truth == 1].max() < 1.5


def test_order_of_the_nodes_and_repeated_nodes_do_not_matter():
    renderer = make(128)
    wire = random_wire(8)
    image = renderer.render(wire).astype(int)
    assert np.abs(renderer.render(wire[::-1]).astype(int) - image).max() <= 1
    doubled = np.repeat(wire, 2, axis=0)
    assert np.isfinite(doubled).all()
    assert ndimage.label(renderer.mask(doubled), EIGHT)[1] == 1


def test_wire_partly_or_wholly_outside_the_image():
    renderer = make(80)
    through = straight_wire([-0.3, 0, 0], [0.3, 0, 0])
    assert renderer.mask(through)[39:41].any(axis=0).all()
    outside = straight_wire([0.3, 0, 0], [0.4, 0, 0.1])
    assert not renderer.mask(outside).any()
    np.testing.assert_array_equal(renderer.render(outside), renderer.background)
    far_away = np.array([[0.0, -0.7, 0.0], [1e7, 0.0, 1e7]])
    assert renderer.mask(far_away).shape == (80, 80)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_nodes_draw_nothing(count):
    renderer = make(80)
    np.testing.assert_array_equal(renderer.render(np.zeros((count, 3))), renderer.background)
    assert not renderer.mask(np.zeros((count, 3))).any()


def test_one_pass_equals_two_and_repeats_itself():
    renderer = make(80)
    wire = random_wire(4)
    image, mask = np.full((80, 80), 7, np.uint8), np.full((80, 80), 7, np.uint8)
    for _ in range(2):
        renderer.render_into(wire, image, mask)
        np.testing.assert_array_equal(image, renderer.render(wire))
        np.testing.assert_array_equal(mask, renderer.mask(wire))


def test_threads_share_a_renderer():
    renderer = make(128)
    wires = [random_wire(seed) for seed in range(40)]
    alone = [renderer.render(wire) for wire in wires]
    with ThreadPoolExecutor(4) as pool:
        np.testing.assert_array_equal(list(pool.map(renderer.render, wires)), alone)


def test_any_view_any_size():
    projector = Projector.view("lateral", BOUNDS, (120, 90))
    renderer = FluoroscopyRenderer(projector, np.full((90, 120), 150.0))
    wire = straight_wire([0, -0.02, -0.04], [0, 0.02, 0.05])
    rows, columns = np.nonzero(renderer.mask(wire))
    pixels = projector.project(wire)
    assert columns.min() == pytest.approx(pixels[:, 0].min(), abs=1.5)
    assert rows.max() == pytest.approx(pixels[:, 1].max(), abs=1.5)


def test_quantum_noise_follows_the_counts():
    image = np.full((200, 200), 120, np.uint8)
    generator = np.random.default_rng(1)
    weak, strong = (quantum_noise(image, photons, generator).astype(float) for photons in (200, 5000))
    assert strong.mean() == pytest.approx(120, abs=0.5)
    assert weak.std() / strong.std() == pytest.approx(5.0, rel=0.1)
    with pytest.raises(ValueError, match="positive number of photons"):
        quantum_noise(image, 0, generator)


def test_noise_is_off_unless_asked_for_and_seeded():
    wire = random_wire(2)
    clean = make(80)
    np.testing.assert_array_equal(clean.render(wire), clean.render(wire))
    noisy = make(80, photons=500)
    first = noisy.render(wire, generator=np.random.default_rng(7))
    np.testing.assert_array_equal(first, noisy.render(wire, generator=np.random.default_rng(7)))
    assert (first != clean.render(wire)).mean() > 0.5
    with pytest.raises(ValueError, match="pass render"):
        noisy.render(wire)


def test_bad_input_is_refused():
    renderer = make(80)
    wire = random_wire(0)
    with pytest.raises(ValueError, match="not finite"):
        renderer.render(np.vstack([wire, [[np.nan, 0, 0]]]))
    with pytest.raises(ValueError, match="behind the X-ray source"):
        renderer.mask(np.vstack([wire, [[0, -2.0, 0]]]))
    with pytest.raises(ValueError, match=r"shape \(n, 3\)"):
        renderer.render(np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"uint8 array of shape \(80, 80\)"):
        renderer.render_into(wire, np.zeros((80, 80)), None)
    with pytest.raises(ValueError, match="C-ordered"):
        renderer.render_into(wire, None, np.zeros((80, 80), np.uint8).T[::2])
    with pytest.raises(ValueError, match="camera's shape"):
        FluoroscopyRenderer(renderer.projector, np.zeros((80, 81)))
    with pytest.raises(ValueError, match="between 0 and 255"):
        FluoroscopyRenderer(renderer.projector, np.full((80, 80), 300.0))
    with pytest.raises(ValueError, match="must be positive"):
        make(80, wire_radius=0.0)
