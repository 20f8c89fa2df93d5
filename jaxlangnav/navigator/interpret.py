"""Interpretation of utterances, and update of a navigator's state by their speech act (host only).

``Navigator.take`` documents the kinds of utterances. Fixed wordings are looked up
(``language.utterance``), other sentences are grounded and merged with the earlier ones
(``dialogue``), and the state is updated by the functions of ``speech_acts``.
"""

import contextlib
import dataclasses
import logging
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue import Merged, compose_poses, merge_utterance
from jaxlangnav.grounding import Context, Grounded, Grounder
from jaxlangnav.grounding.annotated import come_here
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.instruction import Referents
from jaxlangnav.inputs.object_types import is_anything, is_type, label_of, merge_types, name_of
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.language.halting import Act, alarm_in, opening_of
from jaxlangnav.language.lexicon import find_type
from jaxlangnav.language.utterance import Kind, Utterance, Wording, classify
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorState, speech_acts
from jaxlangnav.navigator.candidates import believed_pose, candidates, select_candidate, type_at
from jaxlangnav.navigator.speech_acts import Effect

_INFORMING = {Kind.STATEMENT, Kind.CONSTRAINT}
_NO_COMMAND = {Act.HALT: _INFORMING | {Kind.CORRECTION, Kind.ANSWER}, Act.CANCEL: _INFORMING}
"""Kinds of utterances that do not undo a preceding act: "Stop! That is the wrong one"."""
_Updated = tuple[NavigatorState, "UtteranceOutcome"]
_log = logging.getLogger(__name__)

_merge = jax.jit(speech_acts.tell, static_argnames="effect")
_come_back = jax.jit(speech_acts.come_back)
_come_closer = jax.jit(speech_acts.come_closer)
_choose = jax.jit(speech_acts.choose)
_choose_freely = jax.jit(speech_acts.choose_freely)
_rule_out = jax.jit(speech_acts.rule_out)


@dataclasses.dataclass(frozen=True, kw_only=True)
class UtteranceOutcome:
    """Result of an utterance: its speech act, excluded objects and notes."""

    text: str
    kind: Kind
    ruled_out: tuple[int, ...] = ()  # observed slots that it excludes
    notes: tuple[str, ...] = ()  # messages for people, a line each


@dataclasses.dataclass(frozen=True)
class Listener:
    """Interpreter of utterances, with a grounder."""

    grounder: Grounder

    def take(self, state: NavigatorState, text: str) -> _Updated:
        """Process an utterance; see ``Navigator.take``."""
        is_asked = int(state.status) == Status.WHICH_ONE
        utterance = classify(text, is_asked=is_asked)
        if utterance.kind and utterance.kind in (Kind.HALT, Kind.RESUME, Kind.CANCEL):
            outcome = UtteranceOutcome(text=text, kind=utterance.kind)
            return speech_acts.apply_act(state, Act(utterance.kind)), outcome
        if utterance.wording is not None:
            return self._process_wording(state, text, utterance)
        opening = opening_of(text)
        try:
            after, outcome = self._process_sentence(state, text, utterance, is_asked=is_asked)
        except ValueError as refusal:
            if opening is not None:
                return self._process_opening(state, text, *opening)
            if utterance.kind == Kind.CORRECTION:  # "no rush just go to the bench"
                whole = Utterance(kind=None, rest=text)
                with contextlib.suppress(ValueError):
                    return self._process_sentence(state, text, whole, is_asked=is_asked)
            return self._halt_on_alarm(state, text, refusal)
        if opening is not None and outcome.kind in _INFORMING:
            return _apply_act(after, outcome, opening[0])
        return after, outcome

    def _halt_on_alarm(self, state: NavigatorState, text: str, refusal: ValueError) -> _Updated:
        """Halt a moving robot if a refused utterance may be an alarm; else raise the refusal."""

        def is_object(words: str) -> bool:
            return find_type(words) is not None or words in names_of(self.grounder)

        alarm = None if bool(state.is_resting) else alarm_in(text, is_object)
        if alarm is None:
            raise refusal
        note = (
            f"halted, for it is not understood and {alarm}: say 'go on', or what to do instead; "
            f"{refusal}"
        )
        outcome = UtteranceOutcome(text=text, kind=Kind.HALT, notes=(note,))
        return speech_acts.apply_act(state, Act.HALT), outcome

    def _process_opening(self, state: NavigatorState, text: str, act: Act, rest: str) -> _Updated:
        """Process an utterance that begins by halting or cancelling: the act, then the rest."""
        try:
            after, outcome = self.take(state, rest)
        except ValueError as refusal:
            done = "halted" if act == Act.HALT else "the task is dropped"
            _log.warning("%s; the rest of what was said is left out: %s", done, refusal)
            return _apply_act(state, UtteranceOutcome(text=text, kind=Kind(act)), act)
        outcome = dataclasses.replace(outcome, text=text)
        no_command = outcome.kind in _NO_COMMAND[act]
        return _apply_act(after, outcome, act) if no_command else (after, outcome)

    def _process_wording(self, state: NavigatorState, text: str, utterance: Utterance) -> _Updated:
        """Process an utterance of a fixed wording."""
        slot, kind = int(state.talk.approached), utterance.kind or Kind.ANSWER
        outcome = UtteranceOutcome(text=text, kind=kind)
        if utterance.wording == Wording.RETURN:
            merged = self._join(state, Grounded(instruction=come_here(), annotations=()))
            return _come_back(state, merged), outcome
        if kind == Kind.ANSWER:
            return self._process_answer(state, text, utterance)
        if int(state.instruction.num_clauses) == 0 or slot == NONE:
            raise ValueError(
                f"{shorten(text)!r}: nothing is being approached yet: say what is meant, as in 'go "
                "to the hydrant by the cone'"
            )
        if utterance.wording == Wording.CLOSER:
            return _come_closer(state), outcome
        outcome = dataclasses.replace(outcome, ruled_out=(slot,))
        return _rule_out(state, jnp.int32(1 << slot)), outcome

    def _process_answer(self, state: NavigatorState, text: str, utterance: Utterance) -> _Updated:
        """Process the answer to a question."""
        outcome = UtteranceOutcome(text=text, kind=Kind.ANSWER)
        options = candidates(state, names_of(self.grounder))
        if utterance.wording == Wording.ANY:
            return _choose_freely(state), outcome
        slots = tuple(option.slot for option in options)
        if utterance.wording == Wording.NO:
            bits = jnp.int32(sum(1 << slot for slot in slots))
            return _rule_out(state, bits), dataclasses.replace(outcome, ruled_out=slots)
        chosen = select_candidate(utterance.wording, options, believed_pose(state))
        if chosen is None:
            raise ValueError(
                f"{shorten(text)!r}: it may be one of {len(options)}: say which, as in 'the left "
                "one' or 'the second'"
            )
        others = tuple(slot for slot in slots if slot != chosen.slot)
        after = _choose(state, jnp.int32(chosen.slot))
        return after, dataclasses.replace(outcome, ruled_out=others)

    def _process_sentence(
        self, state: NavigatorState, text: str, utterance: Utterance, *, is_asked: bool
    ) -> _Updated:
        """Ground a sentence, merge it with the dialogue state and update the task."""
        topic, is_at = self._topic(state)
        about = NONE if is_anything(topic) else topic
        context = Context(is_under_way=True, about=about, is_at=is_at)
        grounded = self.grounder.ground(utterance.rest, context)
        spoken = grounded.spoken or Referents()
        pose, notes = state.belief.last_pose, grounded.notes
        if int(grounded.instruction.num_clauses) == 0:
            kind = Kind.CONSTRAINT if spoken.avoided else Kind.STATEMENT
            merged = self._join(state, grounded, effect=Effect.INFORM)
            after = _merge(state, merged, pose, effect=Effect.INFORM)
            notes += _drop_notes(state, after)
            return after, UtteranceOutcome(text=text, kind=kind, notes=notes)
        effect = Effect.REPLACE
        has_task = int(state.instruction.num_clauses) > 0 and not bool(state.is_done)
        if utterance.kind == Kind.ADDITION and has_task:
            effect = Effect.APPEND
            left = int(state.instruction.num_clauses) - int(state.clause)
            total, limit = left + int(grounded.instruction.num_clauses), state.talk.viewer.shape[0]
            if total > limit:
                raise ValueError(
                    f"{shorten(text)!r} makes {total} commands; at most {limit} are held: say it "
                    "again when one of them is carried out"
                )
            if spoken.steps:
                raise ValueError(
                    f"{shorten(text)!r}: where the robot will stand when its task is done is not "
                    "known yet: say it when it is there"
                )
        area = state.belief.coverage.area
        check_metric_goals(spoken, np.asarray(pose).tolist(), np.asarray(area).tolist())
        label, goals = label_of(topic), spoken.goals
        is_answer = is_asked and len(goals) == 1 and label in spoken.types_of(goals[0])
        is_new, is_loose = effect is Effect.REPLACE, is_answer or utterance.kind == Kind.CORRECTION
        excluded = self._excluded_slot(state, utterance, grounded, text) if is_new else NONE
        merged = self._join(state, grounded, effect=effect, is_loose=is_loose or not is_new)
        after = _merge(state, merged, pose, effect=effect)
        if excluded != NONE:
            after = _rule_out(after, jnp.int32(1 << excluded))
        if is_answer:  # ask no second question: the best candidate is accepted
            after = _choose_freely(after)
        kind = utterance.kind or (Kind.ANSWER if is_answer else Kind.COMMAND)
        ruled_out, notes = (excluded,) * (excluded != NONE), notes + _drop_notes(state, after)
        return after, UtteranceOutcome(text=text, kind=kind, ruled_out=ruled_out, notes=notes)

    def _join(
        self,
        state: NavigatorState,
        grounded: Grounded,
        *,
        effect: Effect = Effect.REPLACE,
        is_loose: bool = True,
    ) -> Merged:
        """Merge the new interpretation with the dialogue state."""
        return merge_utterance(
            state.instruction.readings,
            state.talk.words,
            grounded.instruction,
            grounded.spoken,
            is_new_task=effect is Effect.REPLACE,
            is_loose=is_loose,
            is_asked=effect is not Effect.INFORM,
        )

    def _topic(self, state: NavigatorState) -> tuple[int, bool]:
        """Find the object type that the dialogue is about, and whether the robot is at one."""
        approached = int(state.talk.approached)
        if approached != NONE:
            return type_at(state, approached), True
        readings = state.instruction.readings
        best = int(np.argmax(np.asarray(readings.log_probability)))
        goal = int(np.asarray(state.talk.words.goal)[best, int(state.clause)])
        goal_type = NONE if goal == NONE else int(np.asarray(readings.mention_type)[best, goal])
        return (goal_type if goal_type >= 0 else NONE), False

    def _excluded_slot(
        self, state: NavigatorState, utterance: Utterance, grounded: Grounded, text: str
    ) -> int:
        """Find the observed slot that a new task excludes ("the other one"); NONE if none."""
        spoken = grounded.spoken or Referents()
        goal = spoken.goals[0] if spoken.goals else NONE
        approached, last = int(state.talk.approached), int(state.previous_goal)
        slots = [slot for slot in (approached, last) if slot != NONE]
        slots = [slot for slot in slots if label_of(type_at(state, slot)) in spoken.types_of(goal)]
        if len(spoken.goals) == 1 and goal in spoken.others:
            if not slots:
                name = name_of(goal, names_of(self.grounder))
                raise ValueError(
                    f"{shorten(text)!r}: no {name} has been approached yet, so there is no other: "
                    f"say which, as in 'the {name} by the cone'"
                )
            return slots[0]
        if not utterance.rejects_goal or approached not in slots:
            return NONE
        code = type_at(state, approached)
        mentions = np.unique(grounded.instruction.readings.mention_type).tolist()
        described = [m for m in mentions if m != label_of(m) and is_type(code, m)]
        if any(merge_types(code, m) == code for m in described):
            name = name_of(code, names_of(self.grounder))
            raise ValueError(f"{shorten(text)!r}: the {name} is approached: say which is meant")
        return approached

    def warm_up(self, state: NavigatorState) -> None:
        """Compile all state updates by utterances in advance."""
        grounded = Grounded(instruction=come_here(), annotations=())
        merged, slot = self._join(state, grounded), jnp.int32(0)
        for effect in Effect:
            _merge(state, merged, state.belief.last_pose, effect=effect)
        _come_back(state, merged)
        _choose(state, slot)
        _rule_out(state, slot)
        _come_closer(state)
        _choose_freely(state)
        believed_pose(state)


def _apply_act(state: NavigatorState, outcome: UtteranceOutcome, act: Act) -> _Updated:
    """Halt or cancel after the rest of an utterance that begins by that and has no command."""
    return speech_acts.apply_act(state, act), dataclasses.replace(outcome, kind=Kind(act))


def check_metric_goals(
    spoken: Referents | None, pose: Sequence[float], area: Sequence[float]
) -> None:
    """Raise a ValueError for a metric goal outside the operating area (host only)."""
    for end in () if spoken is None else spoken.steps:
        x, y, _ = compose_poses(np.array(pose), np.array([[*end, 0.0]]))[0]
        if not (area[0] <= x <= area[1] and area[2] <= y <= area[3]):
            limits = ", ".join(f"{float(edge):g}" for edge in area)
            raise ValueError(
                f"that leads to ({x:.1f}, {y:.1f}), but the operating area is ({limits}): go less "
                "far, or start with a larger area"
            )


def _drop_notes(before: NavigatorState, after: NavigatorState) -> tuple[str, ...]:
    """Report the statements that were dropped for lack of capacity."""
    count = int(after.talk.words.num_dropped) - int(before.talk.words.num_dropped)
    if count <= 0:
        return ()
    return (f"{count} of what was said of the map earlier is forgotten: there is no room for it",)
