"""Clusters: what they refuse, and how they are sampled."""

import re

import numpy as np
import pytest

from melp_warp.cluster import Bubble, Cluster, Merge, Pop, Wall, e_spacing
from melp_warp.errors import InputError
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation

R = 0.05
APART = (Bubble((-0.06, 0.0, 0.0), R), Bubble((0.06, 0.0, 0.0), R))
FLOOR = Wall((0.0, -0.1, 0.0), (0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Cluster(()), ["bubbles", "at least one"]),
        (lambda: Cluster((*APART, Bubble((0.06, 0.09, 0.0), R))), ["bubbles 1 and 2", "overlap", "0.01 m"]),
        (lambda: Cluster((Bubble((0.0, 0.0, 0.0), R), Bubble((0.0, 0.0, 0.0), 0.01))), ["bubbles 0 and 1", "0.06 m"]),
        (lambda: Cluster((*APART, Bubble((0.0, -0.07, 0.0), 0.04)), (FLOOR,)), ["bubble 2", "wall 0", "0.01 m"]),
        (lambda: Cluster((Bubble((0.0, -0.07, 0.0), R, born=1.0), *APART), (FLOOR,)), ["bubble 0", "wall 0"]),
        (lambda: Cluster((Bubble((0.0, 0.0, 0.0), R, born=1.0),)), ["born", "0 for one bubble"]),
        (lambda: Cluster(APART, events=(Pop(0.1, 2),)), ["region of Pop", "from 0 to 1", "got 2"]),
        (lambda: Cluster(APART, events=(Merge(0.1, 0, -1),)), ["region of Merge", "from 0 to 1", "got -1"]),
        (lambda: Cluster(APART, events=(Merge(0.1, 1, 1),)), ["regions of Merge", "two different"]),
        (lambda: Cluster(APART, events=(Pop(-0.1, 0),)), ["time of Pop", "at least 0", "-0.1"]),
        (lambda: Cluster(APART, events=(Pop(np.nan, 0),)), ["time of Pop", "nan"]),
        (lambda: Bubble((0.0, 0.0), R), ["centre", "three finite numbers"]),
        (lambda: Bubble((0.0, 0.0, np.inf), R), ["centre", "inf"]),
        (lambda: Bubble((0.0, 0.0, 0.0), 0.0), ["radius", "above 0"]),
        (lambda: Bubble((0.0, 0.0, 0.0), R, (0.0, np.nan, 0.0)), ["velocity", "nan"]),
        (lambda: Bubble((0.0, 0.0, 0.0), R, thickness=0.0), ["thickness", "above 0"]),
        (lambda: Bubble((0.0, 0.0, 0.0), R, tension=0.0), ["tension", "from 0.1 to 10"]),
        (lambda: Bubble((0.0, 0.0, 0.0), R, born=-1.0), ["born", "at least 0", "-1"]),
        (lambda: Wall((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)), ["normal", "unit vector"]),
        (lambda: Wall((0.0, 0.0), (0.0, 1.0, 0.0)), ["point", "three finite numbers"]),
    ],
)
def test_refuses(make, words):
    with pytest.raises(InputError) as error:
        make()
    for word in words:
        assert word in str(error.value)


def test_bubbles_that_touch_and_bubbles_to_come_may_share_a_place():
    touching = (Bubble((-R, 0.0, 0.0), R), Bubble((R, 0.0, 0.0), R))
    cluster = Cluster((*touching, Bubble((R, 0.0, 0.0), R, born=0.1), Bubble((0.0, 0.0, 0.0), R, born=0.2)))
    assert cluster.initial == (0, 1)


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_samples_are_even_and_region_by_region(offset):
    radii = (0.02, 0.05, 0.03, 0.04)
    bubbles = [Bubble((0.2 * k, 0.0, 0.0), r, born=0.5 if k == 2 else 0.0) for k, r in enumerate(radii)]
    cluster = Cluster(tuple(bubbles))
    present = [radii[k] for k in cluster.initial]
    samples = cluster.sample(3000, offset)
    assert len(samples.points) == pytest.approx(3000, abs=2)
    assert np.all(np.diff(samples.region) >= 0)
    assert set(samples.region) == {0, 1, 2}
    spacing = e_spacing(present, 3000)
    assert samples.area.sum() == pytest.approx(cluster.area, rel=1e-6)
    for region, label in enumerate(cluster.initial):
        own = samples.region == region
        assert own.sum() == pytest.approx(4.0 * np.pi * radii[label] ** 2 / spacing**2, abs=1)
        away = samples.points[own] - np.array(bubbles[label].centre)
        np.testing.assert_allclose(np.linalg.norm(away, axis=1), radii[label], rtol=1e-9)
        np.testing.assert_allclose(samples.normals[own], away / radii[label], atol=1e-9)


@pytest.mark.parametrize("born", [0.0, 1.0])
def test_a_bubble_too_small_for_the_spacing_is_refused_with_the_count_it_takes(born):
    cluster = Cluster((*APART, Bubble((0.0, 0.2, 0.0), 0.01, born=born)))
    with pytest.raises(InputError) as error:
        Simulation(Scene("small", cluster, e_count=500))
    message = str(error.value)
    assert message.startswith("e_count must be at least")
    assert "bubble 2, of radius 0.01 m, must be 6 spacings across, got 500" in message
    assert ("for the 2 at the start" in message) == (born > 0.0)
    need = int(re.search(r"at least (\d+)", message)[1])
    assert e_spacing([b.radius for b in cluster.bubbles if b.born == 0.0], need) == pytest.approx(0.02 / 6.0, rel=1e-3)
    Simulation(Scene("small", cluster, e_count=need))
