"""The Distributed Correspondence Graph (sections 3.1 and 3.3): what words mean, as data."""

from jaxlangnav.grounding.annotated import AnnotationGrounder
from jaxlangnav.grounding.behavior import infer_behavior, infer_behaviors
from jaxlangnav.grounding.correspondence import (
    CorrespondenceGraph,
    Labelled,
    SymbolSpace,
    read_tree,
    train_graph,
)
from jaxlangnav.grounding.grounder import Context, GraphGrounder, Grounded, Grounder
from jaxlangnav.grounding.instruction import (
    GroundingModel,
    Instruction,
    Understanding,
    understand,
    understand_parse,
)
from jaxlangnav.grounding.program import BehaviorProgram
from jaxlangnav.grounding.weights import load_shipped

__all__ = [
    "AnnotationGrounder",
    "BehaviorProgram",
    "Context",
    "CorrespondenceGraph",
    "GraphGrounder",
    "Grounded",
    "Grounder",
    "GroundingModel",
    "Instruction",
    "Labelled",
    "SymbolSpace",
    "Understanding",
    "infer_behavior",
    "infer_behaviors",
    "load_shipped",
    "read_tree",
    "train_graph",
    "understand",
    "understand_parse",
]
