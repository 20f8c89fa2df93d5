"""A relation with one landmark that the graph expresses as near: its record, its words, this."""

import jax.numpy as jnp
import numpy as np

from jaxlangnav import Navigator
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.relations import REGISTRY, default_params, log_density, prepare, viewer_frame

BESIDE = [one.name for one in REGISTRY].index("beside")


def test_beside_is_read_and_lies_closer_than_near() -> None:
    for text, relation in (("beside", BESIDE), ("next to", BESIDE), ("near", 4)):
        understood = understand(f"go to the hydrant {text} the cone", load_shipped())
        assert int(understood.instruction.readings.relation[0, 0]) == relation
    frame = viewer_frame(-5.0, 0.0, 0.0, 0.0)
    offset = jnp.linspace(0.2, 6.0, 100)
    for relation, most in ((BESIDE, 1.2), (4, 2.2)):
        found = log_density(prepare(default_params()), relation, offset, 0.0 * offset, frame)
        median = most * np.exp(-2.0 * (0.3 if relation == BESIDE else 0.35) ** 2)
        assert abs(float(offset[jnp.argmax(found)]) - median) < 0.06


def test_hypotheses_stand_beside_the_cone() -> None:
    import jax

    navigator = Navigator.pretrained()
    away = []
    for text in ("beside", "near"):
        state = navigator.start(f"go to the hydrant {text} the cone")
        look = navigator.observation((0.0, 0.0, 0.0), [("cone", 2.9, 0.0)])
        state = navigator.step(jax.random.key(0), state, look)[0]
        particles = state.belief.particles
        x, y = np.asarray(particles.hypothesis_x), np.asarray(particles.hypothesis_y)
        is_open = np.asarray(particles.is_hypothesised) & (np.asarray(particles.root) >= 0)
        away.append(np.median(np.hypot(x - 2.9, y)[is_open]))
    assert away[0] < 0.7 * away[1]
