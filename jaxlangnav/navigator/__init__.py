"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper)."""

from jaxlangnav.navigator.cycle import NavigatorInfo as NavigatorInfo, start as start, step as step
from jaxlangnav.navigator.records import (
    NavigatorConfig as NavigatorConfig,
    NavigatorParams as NavigatorParams,
    NavigatorState as NavigatorState,
    check as check,
    default_params as default_params,
)
