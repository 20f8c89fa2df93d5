"""What the robot believes: weighted particles and what they share (section 3.2)."""

from jax import Array

from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.bystanders import Bystanders
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.terrain import Terrain


@pytree
class ParticleBelief:
    """Weighted particles and what they share; the particle axis is last in every particle."""

    particles: SemanticMap  # leaves [..., P]
    log_weight: Array  # f32[P] normalised
    coverage: Coverage  # where the robot has looked
    terrain: Terrain  # how far one sees and walks there, as the robot takes it to be
    bystanders: Bystanders  # things of types that the task does not speak of; B may be 0
    last_pose: Array  # f32[3] dead-reckoned pose at the last observation that was believed
    doubted_pose: Array  # f32[3] … that was reported, believed or not
    is_placed: Array  # bool[] area and start pose are as they were given, and can be
    num_types: Array  # i32[] object types that a detection may name
    viewer: Array  # f32[3] x, y, heading when the last instruction was heard, map frame
    must_ground: Array  # bool[] words have come in that no particle has grounded yet
    log_evidence: Array  # f32[] log predictive probability of all detections and absences so
    # far, relative to a constant per detection; what new groundings of the words add is left out
