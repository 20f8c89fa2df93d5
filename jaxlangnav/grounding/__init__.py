"""The Distributed Correspondence Graph (sections 3.1 and 3.3): what words mean, as data."""

from jaxlangnav.grounding.annotated import AnnotationGrounder
from jaxlangnav.grounding.behavior import infer_behavior, infer_behaviors
from jaxlangnav.grounding.choosing import ChoosingGrounder, FirstGrounder
from jaxlangnav.grounding.correspondence import (
    Block,
    CorrespondenceGraph,
    Described,
    Labelled,
    SymbolSpace,
    read_tree,
)
from jaxlangnav.grounding.grounder import Alternative, Context, GraphGrounder, Grounded, Grounder
from jaxlangnav.grounding.instruction import (
    GroundingModel,
    Instruction,
    Understanding,
    understand,
    understand_parse,
)
from jaxlangnav.grounding.program import BehaviorProgram
from jaxlangnav.grounding.rewrites import (
    RecordedRewrites,
    RewriteGrounder,
    RewriteSource,
    default_rewrite_params,
)
from jaxlangnav.grounding.symbols import Symbols
from jaxlangnav.grounding.weights import load_shipped

__all__ = [
    "Alternative",
    "AnnotationGrounder",
    "BehaviorProgram",
    "Block",
    "ChoosingGrounder",
    "Context",
    "CorrespondenceGraph",
    "Described",
    "FirstGrounder",
    "GraphGrounder",
    "Grounded",
    "Grounder",
    "GroundingModel",
    "Instruction",
    "Labelled",
    "RecordedRewrites",
    "RewriteGrounder",
    "RewriteSource",
    "SymbolSpace",
    "Symbols",
    "Understanding",
    "default_rewrite_params",
    "infer_behavior",
    "infer_behaviors",
    "load_shipped",
    "read_tree",
    "understand",
    "understand_parse",
]
