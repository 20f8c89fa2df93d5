"""The navigator agent: filter, behavior inference and planner in one decision cycle (Figure 2)."""

from jaxlangnav.navigator.cycle import NavigatorInfo as NavigatorInfo, start as start, step as step
from jaxlangnav.navigator.records import (
    NavigatorConfig as NavigatorConfig,
    NavigatorParams as NavigatorParams,
    NavigatorState as NavigatorState,
    check as check,
    default_params as default_params,
)
