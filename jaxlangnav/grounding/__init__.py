"""The Distributed Correspondence Graph (sections 3.1 and 3.3): what words mean, as data."""

from jaxlangnav.grounding.annotated import AnnotationGrounder as AnnotationGrounder
from jaxlangnav.grounding.behavior import (
    infer_behavior as infer_behavior,
    infer_behaviors as infer_behaviors,
)
from jaxlangnav.grounding.correspondence import (
    Block as Block,
    CorrespondenceGraph as CorrespondenceGraph,
    Described as Described,
    Labelled as Labelled,
    SymbolSpace as SymbolSpace,
    read_tree as read_tree,
)
from jaxlangnav.grounding.grounder import (
    Alternative as Alternative,
    ChoosingGrounder as ChoosingGrounder,
    Context as Context,
    FirstGrounder as FirstGrounder,
    GraphGrounder as GraphGrounder,
    Grounded as Grounded,
    Grounder as Grounder,
)
from jaxlangnav.grounding.instruction import (
    GroundingModel as GroundingModel,
    Instruction as Instruction,
    Understanding as Understanding,
    understand as understand,
    understand_parse as understand_parse,
)
from jaxlangnav.grounding.program import CompiledClause as CompiledClause
from jaxlangnav.grounding.rewrites import (
    RecordedRewrites as RecordedRewrites,
    RewriteGrounder as RewriteGrounder,
    RewriteSource as RewriteSource,
)
from jaxlangnav.grounding.symbols import SymbolDomain as SymbolDomain
from jaxlangnav.grounding.weights import load_shipped as load_shipped
