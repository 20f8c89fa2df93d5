"""Modules of the reference that stand elsewhere now: their old names work, and warn."""

import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType

MOVED = {
    "lanes": "episode.lanes",
    "recording": "episode.recording",
    "recorder": "episode.recorder",
    "conversation": "dialogue",
    "conversation.history": "dialogue.history",
    "conversation.join": "dialogue.merge",
    "conversation.memory": "dialogue.memory",
    "hearing": "navigator.speech_acts",
    "listening": "navigator.interpret",
    "agent": "navigator.api",
    "kept": "inputs.program_cache",
    "kinds": "inputs.object_types",
    "experiments.grid": "experiments.experiment",
    "experiments.table2": "experiments.paper",
    "experiments.figure5": "experiments.paper",
    "experiments.report": "experiments.table",
    "experiments.reliability": "experiments.judging",
    "studies.unknowns": "experiments.unknowns",
    "experiments.goal_region": "experiments.calibration",
    "robots.motion.pursuit": "robots.motion.steering",
    "robots.motion.window": "robots.motion.steering",
    "robots.record": "robots.robot",
    "robots.simulated": "robots.kinematic",
    "robots.ros2.headway": "robots.ros2.robot",
    "robots.ros2.recording": "robots.ros2.bags",
    "robots.ros2.serve": "robots.ros2.simulation",
    "navigator.outcome": "navigator.records",
    "relations.frames": "relations.table",
    "world.errors": "world.sensor",
    "world.known": "world.simulator",
    "grounding.annotation_properties": "grounding.properties",
    "grounding.beam": "grounding.behavior",
    "grounding.choosing": "grounding.grounder",
    "grounding.graph": "grounding.symbols",
    "grounding.json_schema": "grounding.form",
    "grounding.recorded": "grounding.rewrites",
    "grounding.space": "grounding.correspondence",
    "grounding.spoken": "grounding.instruction",
    "grounding.weighed": "grounding.correspondence",
    "training.design": "training.examples",
    "planner.asking": "planner.questions",
    "planner.drafts": "planner.tours",
    "planner.tour_proposals": "planner.tours",
    "planner.endings": "planner.termination",
    "semantic_map.bystanders": "semantic_map.unreferenced_objects",
    "semantic_map.candidates": "semantic_map.proposal.candidates",
    "semantic_map.choose": "semantic_map.proposal.sample",
    "semantic_map.draws": "semantic_map.proposal.utterance",
    "semantic_map.gathered": "semantic_map.proposal.utterance",
    "semantic_map.looking": "semantic_map.heading_bias",
    "semantic_map.order": "semantic_map.proposal.ranks",
    "semantic_map.regrounding": "semantic_map.proposal.sparse_regrounding",
    "semantic_map.said": "semantic_map.proposal.relation_query",
    "semantic_map.soundness": "semantic_map.gating",
    "semantic_map.surprise": "semantic_map.observe",
    "semantic_map.ways": "semantic_map.proposal.enumerate",
    "semantic_map.words": "semantic_map.proposal.utterance",
    "terrain.travel": "terrain.view",
    "training.evaluation": "training.scoring",
    "training.labelled": "training.examples",
    "training.search_many": "grounding.search",
}
"""In the package: old names and new ones. An entry goes after one release."""
RENAMED = {
    "kept": {"kept": "cached_jit", "keep_in": "set_cache_dir", "kept_in": "cache_dir"},
    "lanes": {"Course": "EpisodeProgram"},
    "listening": {"Heard": "UtteranceOutcome"},
}
"""Of a module that has moved: what it called otherwise."""


class _Moved(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds a module of an old name as a copy of the names of the new one."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Know the old names."""
        del path, target
        name = fullname.removeprefix("jaxlangnav.")
        # A package of which all modules have moved is found too, empty.
        is_parent = any(old.startswith(f"{name}.") for old in MOVED)
        if name not in MOVED and not is_parent:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=is_parent)

    def exec_module(self, module: ModuleType) -> None:
        """Take over what the new module defines."""
        old = module.__name__.removeprefix("jaxlangnav.")
        if old not in MOVED:
            return
        new = f"jaxlangnav.{MOVED[old]}"
        warnings.warn(f"jaxlangnav.{old} is now {new}", DeprecationWarning, stacklevel=2)
        names = vars(importlib.import_module(new))
        vars(module).update({name: one for name, one in names.items() if name[:2] != "__"})
        vars(module).update({name: names[now] for name, now in RENAMED.get(old, {}).items()})


def know_old_names() -> None:
    """Let old names be imported; asked last, when nothing else has found a module."""
    sys.meta_path.append(_Moved())
