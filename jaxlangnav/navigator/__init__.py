"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper)."""

from jaxlangnav.navigator.cycle import NavigatorInfo, start, step
from jaxlangnav.navigator.records import (
    NavigatorConfig,
    NavigatorParams,
    NavigatorState,
    check,
    default_params,
)

__all__ = [
    "NavigatorConfig",
    "NavigatorInfo",
    "NavigatorParams",
    "NavigatorState",
    "check",
    "default_params",
    "start",
    "step",
]
