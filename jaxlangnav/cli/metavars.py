"""Kinds of options that may be left out: help names them DIR, FILE, METRES, not {None}|PATH."""

from pathlib import Path
from typing import Annotated

import tyro

Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
Metres = Annotated[float | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]
ByStep = Annotated[str, tyro.conf.arg(metavar="STEP:TEXT")]
WorldName = Annotated[str | None, tyro.conf.arg(metavar="WORLD", help_behavior_hint="")]
Number = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
Ranges = Annotated[str | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]
