"""What is to be avoided is avoided: driven in plain NumPy worlds (``avoiding``)."""

import avoiding
import numpy as np
import pytest
from stepping import one_by_one

ROUND, AFTER = avoiding.SENTENCES[1], "stay away from the cone and go to the hydrant"


@pytest.mark.parametrize(
    ("text", "hydrant", "cone"),
    [
        (ROUND, (7.56, -3.61), (2.29, -0.63)),
        (ROUND, (5.35, 0.08), (2.65, 0.06)),
        (AFTER, (6.26, -1.22), (4.02, -0.36)),
    ],
)
def test_named_places(text: str, hydrant: tuple[float, float], cone: tuple[float, float]) -> None:
    """All is seen at once: what is not cannot be gone round, or has to be found first."""
    place = np.array([hydrant, cone])
    shortest = avoiding.shortest_way(np.zeros(2), place[0], place[1:], avoiding.AREA)
    for ride in avoiding.drive(
        [place] * 6, text, list(range(6)), sight=9.0, misses=0.0, stepping=one_by_one
    ):
        assert ride.arrives(place[0]), ride.status
        assert ride.nearest(place[1:]) >= avoiding.KEPT
        assert ride.metres <= 1.25 * shortest + 1.0


@pytest.mark.slow
@pytest.mark.parametrize("num_avoided", [1, 2])
@pytest.mark.parametrize("sight", [4.0, 20.0])
def test_random_places(num_avoided: int, sight: float) -> None:
    found = avoiding.measure(100, num_avoided, sight=sight)
    assert found.is_kept[found.is_possible].mean() >= 0.98, found.line()
    assert found.arrives.mean() >= min(0.98, found.arrives_freely.mean()), found.line()
    # With the goal in sight from the start the way can be held against the shortest one.
    if sight > 15.0:
        assert np.nanmean(found.ratio) <= 1.25, found.line()
    else:
        assert np.nanmean(found.to_free) <= 1.25, found.line()
