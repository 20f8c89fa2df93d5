"""A share of false relations costs no more success than saying no relation at all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.experiments.monte_carlo import run_tasks
from jaxlangnav.experiments.tasks import cell, concatenate, make_tasks
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace

TOLD = ("go to the hydrant", "go to the hydrant behind the cone")
FALSE = ("go to the hydrant in front of the cone", "go to the hydrant to the left of the cone")
"""Said of worlds in which the hydrant stands behind the cone."""
WORLDS = ("1H1C", "1H2C", "2H1C")
EPISODES, SEED = 48, 4000
CONFIG = NavigatorConfig(planner=PlannerConfig(policy="informed"))


def success(params: NavigatorParams, sentences: tuple[int, ...], world: str) -> np.ndarray:
    model = load_shipped()
    instructions = jax.tree.map(
        lambda *leaves: jnp.stack(leaves),
        *(understand(text, model).instruction for text in TOLD + FALSE),
    )
    relation = "null" if sentences == (0,) else "behind"
    tasks = concatenate(
        [
            make_tasks(cell(world, relation, index, 3.0, EPISODES // len(sentences), SEED))
            for index in sentences
        ]
    )
    result = run_tasks(tasks, instructions, params=params, config=CONFIG)
    return np.asarray(result.is_success, float)


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
def test_a_third_of_false_relations_is_no_worse_than_none(world: str) -> None:
    params = default_params()
    null = success(params, (0,), world)
    told, false = success(params, (1,), world), success(params, (2, 3), world)
    mixed = 0.7 * told.mean() + 0.3 * false.mean()
    error = np.sqrt(sum(part.var() / part.size for part in (null, told, false)))
    assert mixed >= null.mean() - 2.0 * error - 1e-9, (mixed, null.mean())


@pytest.mark.slow
def test_without_the_mixture_a_false_relation_is_searched_for_in_vain() -> None:
    params = default_params()
    trusting = replace(params, map=replace(params.map, misleading=jnp.float32(0.0)))
    assert success(trusting, (2,), "1H1C").mean() < 0.5
    assert success(params, (2,), "1H1C").mean() > 0.9
