"""What a sweep may vary (traced) and what fixes the shapes (static) of the planner."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree

POLICIES = ("faithful", "informed")


@pytree
class PlannerParams:
    """Numbers of the planner; traced."""

    discount: Array  # f32[] γ per metre (eq. 12)
    stop_probability: Array  # f32[] τ, goal probability within reach at which the robot stops
    reach: Array  # f32[] metres from the goal that count as having arrived
    frontier_miss: Array  # f32[] cells missed more likely than this share of the worst are unseen
    visit_spacing: Array  # f32[] metres between visited nodes
    rival_share: Array  # f32[] unseen rivals near things seen that a goal may have, relative to it
    rest_share: Array  # f32[] goal probability still unseen, relative to the best, that is let go
    prior_share: Array  # f32[] how far the order of search trusts the learned prior; 0: not at all
    give_up: Array  # f32[] probability that what is missing is there at all, below which the
    # search ends; of ``informed``, 0: never
    constraint_cost: Array  # f32[] value lost by a path through a region to be kept out of
    question_cost: Array  # f32[] what a question costs, in probability of success; ∞: never ask


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """Sizes and policy of the planner; hashable, a change recompiles."""

    policy: str | Callable[[Any], Any] = "faithful"
    """One of ``POLICIES``, or a ``planner.own.Policy``."""
    num_visited: int = 16
    num_blocks: int = 6

    def __post_init__(self) -> None:
        """Refuse what the planner cannot work with."""
        if not callable(self.policy) and self.policy not in POLICIES:
            raise ValueError(f"policy is {self.policy!r}, but must be one of {', '.join(POLICIES)}")
        if self.num_visited < 1 or self.num_blocks < 1:
            raise ValueError("num_visited and num_blocks must be at least 1")

    @property
    def policy_name(self) -> str:
        """The policy's name, for people: that of the function where it is one."""
        if isinstance(self.policy, str):
            return self.policy
        return getattr(self.policy, "__name__", "own")


def default_planner_params() -> PlannerParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return PlannerParams(
        discount=jnp.float32(0.8),
        stop_probability=jnp.float32(0.7),
        reach=jnp.float32(1.2),
        frontier_miss=jnp.float32(0.5),
        visit_spacing=jnp.float32(1.0),
        rival_share=jnp.float32(0.1),
        rest_share=jnp.float32(0.25),
        prior_share=jnp.float32(0.8),
        give_up=jnp.float32(0.15),
        constraint_cost=jnp.float32(1.0),
        question_cost=jnp.float32(jnp.inf),
    )
