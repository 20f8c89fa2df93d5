"""Words for the slots of the corpus templates.

Words after a bar are for test sentences only, so that the hold-out holds words never trained on.
"""

import random

WORDS = {
    "hydrant": "hydrant hydrant hydrant fire_hydrant | fireplug",
    "cone": "cone cone cone traffic_cone | pylon safety_cone",
    "car": "car car car vehicle | automobile sedan",
    "building": "building building house | office_building warehouse",
    "tree": "tree tree tree oak_tree | pine",
    "bench": "bench bench park_bench | seat",
    "barrel": "barrel barrel drum | keg",
    "box": "box box cardboard_box crate | carton",
    "front": "in_front_of in_front_of ahead_of | to_the_front_of",
    "behind": "behind behind behind in_back_of | at_the_back_of on_the_other_side_of",
    "left": "to_the_left_of to_the_left_of left_of on_the_left_of | on_the_left_side_of",
    "right": "to_the_right_of to_the_right_of right_of on_the_right_of | on_the_right_side_of",
    "near": "near next_to close_to beside near next_to | adjacent_to alongside in_the_vicinity_of",
    "far": "far_from away_from far_from | far_away_from distant_from",
    "robot front": "in_front_of_you ahead_of_you ahead | straight_ahead",
    "robot behind": "behind_you in_back_of_you | at_your_back",
    "robot left": "on_your_left to_your_left on_the_left to_the_left_of_you | on_your_left_side",
    "robot right": "on_your_right to_your_right on_the_right | on_your_right_hand_side",
    "robot near": "near_you close_to_you next_to_you | nearby",
    "robot far": "far_from_you far_away | in_the_distance",
    "most near": "nearest_to closest_to nearest closest | nearest",
    "most far": "farthest_from furthest_from | farthest_away_from",
    "adj near": "nearest closest nearest | nearer",
    "adj far": "farthest furthest | most_distant",
    "go": "go go go go move move drive walk head proceed navigate come | travel run return step",
    "at": "stop stop park park wait stand | halt stay",
    "find": "find find find locate | spot detect",
    "approach": "approach approach follow reach | visit",
    "adv": "quickly quickly slowly slowly carefully fast | cautiously rapidly gently swiftly",
    "pol": "please please can_you could_you robot, hey_robot, can_you_please i_want_you_to "
    "would_you please, hey_buddy, now try_to you_need_to could_you let's will_you_please "
    "i_need_you_to ok_now first robot_please go_and okay, would_you_please we_need_to "
    "| kindly could_you_please i'd_like_you_to you_should okay_robot, go_ahead_and "
    "your_task_is_to listen, um_can_you",
    "det": "the the a that | this",
    "J": "red blue big small yellow old tall large orange white | rusty tiny green huge wooden",
}
RELATION_WEIGHTS = {"near": 38, "behind": 20, "front": 12, "left": 11, "right": 11, "far": 8}
ROBOT_WEIGHTS = {"left": 28, "right": 28, "front": 20, "behind": 12, "near": 8, "far": 4}
TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")


class Slots:
    """Fills the slots of one sentence and remembers what they mean."""

    def __init__(self, rng: random.Random, words: dict[str, str], *, is_test: bool) -> None:
        """Keep the random numbers and the split.

        Args:
            rng: draws the words.
            words: choices per list.
            is_test: whether the words after the bar may be used.
        """
        self.rng = rng
        self.words = words
        self.is_test = is_test
        self.meaning: dict[str, str] = {}

    def choose(self, name: str) -> str:
        """Draw an expression from a list."""
        common, _, held_out = self.words[name].partition("|")
        choices = common.split()
        if self.is_test and held_out.split() and self.rng.random() < 0.3:
            choices = held_out.split()
        return self.rng.choice(choices).replace("_", " ")

    def _relation(self, slot: str, weights: dict[str, int], prefix: str) -> str:
        names = list(weights)
        relation = self.rng.choices(names, [weights[name] for name in names])[0]
        self.meaning[slot] = relation
        return self.choose(prefix + relation)

    def fill(self, slot: str) -> str:
        """Fill one slot.

        Args:
            slot: name in the template, without braces.

        Returns:
            Its words; a type slot used twice in a template keeps its type.
        """
        if slot in ("a", "b", "c", "d"):
            if slot not in self.meaning:
                left = [t for t in TYPES if t not in self.meaning.values()]
                self.meaning[slot] = self.rng.choice(left)
            return self.choose(self.meaning[slot])
        if slot in ("R", "Q"):
            return self._relation(slot, RELATION_WEIGHTS, "")
        if slot == "S":
            return self._relation(slot, ROBOT_WEIGHTS, "robot ")
        if slot == "T":
            return self._relation(slot, {"left": 3, "right": 3, "front": 2, "behind": 2}, "robot ")
        if slot == "M":
            return self._relation(slot, {"near": 3, "far": 1}, "most ")
        if slot == "L":
            return self._relation(slot, {"near": 3, "far": 1}, "adj ")
        return self.choose(slot)
