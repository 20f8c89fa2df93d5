"""What commands set up before an episode: trained models, and the engine compiled meanwhile."""

import contextlib
import threading
from pathlib import Path

from jaxlangnav import recorder
from jaxlangnav.experiments.sizes import any_task
from jaxlangnav.grounding.instruction import GroundingModel, Instruction
from jaxlangnav.grounding.weights import load, load_shipped
from jaxlangnav.inputs.program_cache import kept_in
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams


def load_models(path: Path | None) -> GroundingModel:
    """Load models that ``jaxlangnav train`` wrote, or the shipped ones; refuses other files."""
    return load_shipped() if path is None else load(path)


def rehearse(
    instructions: Instruction,
    num_slots: int,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> None:
    """Load or compile the decision cycle in a thread, while other things are done.

    A step of an episode in an empty world asks for it: shapes are the same for every sentence,
    leaves [1, …], in every world with as many slots. Where no programs are kept nothing is done, as
    two threads would compile the same.
    """
    if kept_in() is None:
        return
    task = any_task(num_slots)

    def step() -> None:
        # What goes wrong here goes wrong again where it is asked for, and is told there.
        with contextlib.suppress(Exception):
            next(recorder.play(task, instructions, params=params, config=config))

    threading.Thread(target=step).start()
