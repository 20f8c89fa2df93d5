"""Utterances during an episode, from a script, a person at hand or a simulated person.

The ``Dialogue`` of ``recorder.play`` applies every utterance to the state as it then is, and
records its speech act and what it changed. A refused utterance is recorded too and leaves the state
unchanged.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue import discourse_of
from jaxlangnav.episode import EpisodeState
from jaxlangnav.episode.recording import Recording, Remark, StaticScene
from jaxlangnav.experiments.dialogue import QUESTION_COST, speak
from jaxlangnav.grounding import Context, Grounder
from jaxlangnav.grounding.command_summary import summarize_commands
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.instruction import Understanding, pad_instruction
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.language.halting import alarm_in, opening_of
from jaxlangnav.language.utterance import Kind, classify
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorParams, NavigatorState
from jaxlangnav.navigator.candidates import Candidate, candidates, object_at
from jaxlangnav.navigator.interpret import Listener
from jaxlangnav.pytree import replace
from jaxlangnav.world.person import Person, PersonParams, Says, new_person

_RANKS = ("the first", "the second", "the third", "the fourth", "the fifth", "the sixth")
_WORDS = {int(Says.OTHER): "no, the other one", int(Says.NONE_OF_THEM): "no"}
_speak = cached_jit()(speak)


@dataclasses.dataclass
class SimulatedPerson:
    """A simulated person who watches the robot in one episode and may speak to it."""

    params: PersonParams
    person: Person = dataclasses.field(default_factory=new_person)
    _step: int = -1

    def is_present(self, state: EpisodeState) -> bool:
        """Test whether the person would speak in this state."""
        return bool(_speak(state, self.person, params=self.params)[0].will_speak)

    def speak(self, step: int, state: EpisodeState, options: Sequence[Candidate]) -> str | None:
        """Sample what the person says, at most once before each decision; None: nothing."""
        if step == self._step:
            return None
        self._step = step
        self.person, act, slot = _speak(state, self.person, params=self.params)
        if int(act) != Says.THIS:
            return _WORDS.get(int(act))
        return name_candidates(options).get(int(slot))


def name_candidates(options: Sequence[Candidate]) -> dict[int, str]:
    """Name each candidate of a question by its rank in distance, by slot."""
    slots = [candidate.slot for candidate in options]
    return dict.fromkeys(slots[-1:], "the farthest") | dict(zip(slots, _RANKS, strict=False))


def allow_questions(params: NavigatorParams) -> NavigatorParams:
    """Give questions a finite cost where they have none yet."""
    if math.isfinite(float(params.planner.question_cost)):
        return params
    cost = jnp.float32(QUESTION_COST)
    return replace(params, planner=replace(params.planner, question_cost=cost))


GOAL_CHANGING_KINDS = frozenset(
    {Kind.COMMAND, Kind.ADDITION, Kind.RETURN, Kind.CANCEL, Kind.CORRECTION, Kind.ANSWER}
)
"""Kinds of utterances that may change the goal for which the world was opened."""
YOU = "you"

Speaker = Callable[[int, EpisodeState, Sequence[Candidate]], str | None]
"""Returns the next utterance or None, given the step, the episode and the question's candidates."""
_MAX_PER_STEP = 8
"""Maximum number of utterances of one speaker before a step."""


def padded(understood: Understanding) -> Understanding:
    """Pad the arrays of a sentence to the capacity of the dialogue state."""
    instruction = pad_instruction(understood.instruction, Capacity())
    return dataclasses.replace(understood, instruction=instruction)


def check_utterance(grounder: Grounder, first: Understanding, text: str) -> None:
    """Refuse an utterance that is not understood in any state of the dialogue after ``first``.

    Raises:
        ValueError: the words are not understood; one line.
    """
    utterance = classify(text)
    if utterance.kind is not None and not utterance.rest:
        return
    if utterance.wording is not None or classify(text, is_asked=True).wording is not None:
        return
    if opening_of(text) is not None or alarm_in(text, lambda words: False) is not None:
        return
    about = next((goal for goal in first.spoken.goals if goal not in (NONE, ANYTHING)), NONE)
    grounder.ground(utterance.rest, Context(is_under_way=True, about=about, is_at=about != NONE))


@dataclasses.dataclass(kw_only=True)
class Dialogue:
    """Dialogue of an episode: its speakers, and the record of its ``utterances`` so far."""

    grounder: Grounder
    first: Understanding  # instruction before the first step
    scene: StaticScene
    script: Mapping[int, Sequence[str]] = dataclasses.field(default_factory=dict)  # by step
    speakers: Mapping[str, Speaker] = dataclasses.field(default_factory=dict)  # by name
    is_present: Callable[[EpisodeState], bool] = lambda state: False
    """Whether a speaker is present who may still speak to a robot that stands still."""
    on_heard: Callable[[Remark], object] = lambda utterance: None  # called after each one
    utterances: list[Remark] = dataclasses.field(default_factory=list)
    candidates: tuple[Candidate, ...] = ()  # of the last question
    _step: int = 0

    def begin(self, state: EpisodeState) -> EpisodeState:
        """Set the dialogue state to the first sentence, as later ones may refer to it."""
        words = discourse_of(self.first.instruction, self.first.spoken)
        navigator = state.navigator
        talk = replace(navigator.talk, words=words)
        return replace(state, navigator=replace(navigator, talk=talk))

    def hear(self, step: int, state: EpisodeState) -> EpisodeState:
        """Process the utterances before the decision of a step."""
        self._step = step
        for text in self.script.get(step, ()):
            state = self._process(step, state, YOU, text)
        for name, speaker in self.speakers.items():
            for _ in range(_MAX_PER_STEP):
                text = speaker(step, state, self._candidates(state))
                if text is None:
                    break
                state = self._process(step, state, name, text)
        return state

    def expects(self, state: EpisodeState) -> bool:
        """Test whether a further utterance may reach a robot that stands still."""
        self.candidates = tuple(self._candidates(state))
        return any(step > self._step for step in self.script) or self.is_present(state)

    def _candidates(self, state: EpisodeState) -> list[Candidate]:
        navigator = state.navigator
        is_asking = int(navigator.status) == Status.WHICH_ONE
        return candidates(navigator, names_of(self.grounder)) if is_asking else []

    def _process(self, step: int, state: EpisodeState, speaker: str, text: str) -> EpisodeState:
        """Apply an utterance to the state, unless it is refused, and record it."""
        before, names = state.navigator, names_of(self.grounder)
        try:
            after, outcome = Listener(self.grounder).take(before, text)
        except ValueError as refusal:
            reason = str(refusal).removeprefix(f"{shorten(text)!r}: ")
            line = " ".join(reason.split()).rstrip(".")
            utterance = Remark(step=step, text=text, speaker=speaker, refusal=line)
        else:
            utterance = Remark(
                step=step,
                text=text,
                kind=str(outcome.kind),
                speaker=speaker,
                ruled_out=tuple(object_at(before, slot, names) for slot in outcome.ruled_out),
                notes=outcome.notes,
                scene=self._updated_scene(before, after),
            )
            state = replace(state, navigator=after)
        self.utterances.append(utterance)
        self.on_heard(utterance)
        return state

    def _updated_scene(self, before: NavigatorState, after: NavigatorState) -> StaticScene | None:
        """Build the scene of the merged instruction; None where an utterance left it unchanged."""
        merged, previous = jax.device_get((after.instruction, before.instruction))
        if jax.tree.all(jax.tree.map(np.array_equal, merged, previous)):
            return None
        return dataclasses.replace(
            self.scene,
            readings=merged.readings,
            commands=tuple(summarize_commands(merged)),
            type_names=tuple(names_of(self.grounder)),
        )


def add_talk(recording: Recording, dialogue: Dialogue) -> Recording:
    """Add the utterances of an episode to its recording.

    A person at hand may have changed the goal for which the world was opened; success is undefined
    then. A simulated person means that goal.
    """
    by_user = (utterance for utterance in dialogue.utterances if utterance.speaker == YOU)
    scene, result = recording.scene, recording.result
    if any(utterance.kind in GOAL_CHANGING_KINDS for utterance in by_user) and scene.is_scored:
        reason = "what was said under way may mean another goal"
        scene = dataclasses.replace(scene, is_scored=False, unscored=reason)
        result = replace(result, is_success=np.asarray(False))
    return dataclasses.replace(
        recording,
        scene=scene,
        result=result,
        utterances=tuple(dialogue.utterances),
        candidates=dialogue.candidates if int(result.ending) == Status.WHICH_ONE else (),
    )
