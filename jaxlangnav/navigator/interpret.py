"""Interpret an utterance, and update a navigator's state by its speech act (host).

``Navigator.take`` documents what an utterance may be. Here its wording is looked up
(``language.utterance``), what is left is grounded and merged with the utterances before
(``dialogue``), and the state is changed by the functions of ``speech_acts``.
"""

import dataclasses
import logging
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue import Merged, join, seen_from
from jaxlangnav.grounding import Context, Grounded, Grounder
from jaxlangnav.grounding.annotated import come_here
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.instruction import Spoken
from jaxlangnav.inputs.object_types import is_anything, label_of, noun_of
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.language.halting import Act, alarm_in, opening_of
from jaxlangnav.language.lexicon import find_type
from jaxlangnav.language.utterance import Kind, Utterance, Wording, classify
from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorState, speech_acts
from jaxlangnav.navigator.candidates import believed_pose, candidates, chosen_by, type_at
from jaxlangnav.navigator.speech_acts import Effect

_ACTS = {Kind.HALT: Act.HALT, Kind.RESUME: Act.RESUME, Kind.CANCEL: Act.CANCEL}
_BY_ACT = {act: kind for kind, act in _ACTS.items()}
_INFORMING = {Kind.STATEMENT, Kind.CONSTRAINT}
_NO_COMMAND = {Act.HALT: _INFORMING | {Kind.CORRECTION, Kind.ANSWER}, Act.CANCEL: _INFORMING}
"""What words to halt or to cancel hold for, said before it: "Stop! That is the wrong one"."""
_Updated = tuple[NavigatorState, "UtteranceOutcome"]
_log = logging.getLogger(__name__)

_tell = jax.jit(speech_acts.tell, static_argnames="how")
_come_back = jax.jit(speech_acts.come_back)
_come_closer = jax.jit(speech_acts.come_closer)
_choose = jax.jit(speech_acts.choose)
_choose_freely = jax.jit(speech_acts.choose_freely)
_rule_out = jax.jit(speech_acts.rule_out)


@dataclasses.dataclass(frozen=True, kw_only=True)
class UtteranceOutcome:
    """Result of an utterance: its interpretation, and what it changed."""

    text: str
    kind: Kind
    ruled_out: tuple[int, ...] = ()  # observed slots that it says are not meant
    notes: tuple[str, ...] = ()  # what else people should know, a line each


@dataclasses.dataclass(frozen=True)
class Listener:
    """Interpreter of utterances, with a grounder."""

    grounder: Grounder

    def take(self, state: NavigatorState, text: str) -> _Updated:
        """Take in an utterance; see ``Navigator.take``."""
        is_asked = int(state.status) == Status.WHICH_ONE
        said = classify(text, is_asked=is_asked)
        if said.kind is not None and said.kind in _ACTS:
            outcome = UtteranceOutcome(text=text, kind=said.kind)
            return speech_acts.apply_act(state, _ACTS[said.kind]), outcome
        if said.wording is not None:
            return self._by_wording(state, text, said)
        opening = opening_of(text)
        try:
            after, heard = self._by_sentence(state, text, said, is_asked=is_asked)
        except ValueError as refusal:
            if opening is not None:
                return self._opened(state, text, *opening)
            return self._alarmed(state, text, refusal)
        if opening is not None and heard.kind in _INFORMING:
            return _acted(after, heard, opening[0])
        return after, heard

    def _alarmed(self, state: NavigatorState, text: str, refusal: ValueError) -> _Updated:
        """Halt a robot under way for words that alarm and were refused; else refuse them."""

        def is_object(words: str) -> bool:
            return find_type(words) is not None or words in names_of(self.grounder)

        taken = None if bool(state.is_resting) else alarm_in(text, is_object)
        if taken is None:
            raise refusal
        note = (
            f"halted, for it is not understood and {taken}: say 'go on', or what to do instead; "
            f"{refusal}"
        )
        outcome = UtteranceOutcome(text=text, kind=Kind.HALT, notes=(note,))
        return speech_acts.apply_act(state, Act.HALT), outcome

    def _opened(self, state: NavigatorState, text: str, act: Act, rest: str) -> _Updated:
        """Halt, or drop the task, and then take in the rest of what was said."""
        try:
            after, heard = self.take(state, rest)
        except ValueError as refusal:
            done = "halted" if act == Act.HALT else "the task is dropped"
            _log.warning("%s; the rest of what was said is left out: %s", done, refusal)
            return speech_acts.apply_act(state, act), UtteranceOutcome(text=text, kind=_BY_ACT[act])
        heard = dataclasses.replace(heard, text=text)
        return _acted(after, heard, act) if heard.kind in _NO_COMMAND[act] else (after, heard)

    def _by_wording(self, state: NavigatorState, text: str, said: Utterance) -> _Updated:
        """Take in what its wording says all of."""
        at, kind = int(state.talk.approached), said.kind or Kind.ANSWER
        heard = UtteranceOutcome(text=text, kind=kind)
        if said.wording == Wording.RETURN:
            joined = self._join(state, Grounded(instruction=come_here(), annotations=()))
            return _come_back(state, joined), heard
        if kind == Kind.ANSWER:
            return self._answered(state, text, said)
        if int(state.instruction.num_clauses) == 0 or at == NONE:
            raise ValueError(
                f"{shorten(text)!r}: nothing is being approached yet: say what is meant, as in 'go "
                "to the hydrant by the cone'"
            )
        if said.wording == Wording.CLOSER:
            return _come_closer(state), heard
        return _rule_out(state, jnp.int32(1 << at)), dataclasses.replace(heard, ruled_out=(at,))

    def _answered(self, state: NavigatorState, text: str, said: Utterance) -> _Updated:
        """Process the answer to a question."""
        heard = UtteranceOutcome(text=text, kind=Kind.ANSWER)
        found = candidates(state, names_of(self.grounder))
        if said.wording == Wording.ANY:
            return _choose_freely(state), heard
        slots = tuple(one.slot for one in found)
        if said.wording == Wording.NO:
            none = jnp.int32(sum(1 << slot for slot in slots))
            return _rule_out(state, none), dataclasses.replace(heard, ruled_out=slots)
        chosen = chosen_by(said.wording, found, believed_pose(state))
        if chosen is None:
            raise ValueError(
                f"{shorten(text)!r}: it may be one of {len(found)}: say which, as in 'the left "
                "one' or 'the second'"
            )
        others = tuple(slot for slot in slots if slot != chosen.slot)
        after = _choose(state, jnp.int32(chosen.slot))
        return after, dataclasses.replace(heard, ruled_out=others)

    def _by_sentence(
        self, state: NavigatorState, text: str, said: Utterance, *, is_asked: bool
    ) -> _Updated:
        """Take in what has to be understood."""
        about, is_at = self._about(state)
        known = NONE if is_anything(about) else about
        context = Context(is_under_way=True, about=known, is_at=is_at)
        grounded = self.grounder.ground(said.rest, context)
        spoken = grounded.spoken or Spoken()
        pose, notes = state.belief.last_pose, grounded.notes
        if int(grounded.instruction.num_clauses) == 0:
            kind = Kind.CONSTRAINT if spoken.avoided else Kind.STATEMENT
            joined = self._join(state, grounded, how=Effect.INFORM)
            after = _tell(state, joined, pose, how=Effect.INFORM)
            notes += _dropped(state, after)
            return after, UtteranceOutcome(text=text, kind=kind, notes=notes)
        how = Effect.REPLACE
        has_more = int(state.instruction.num_clauses) > 0 and not bool(state.is_done)
        if said.kind == Kind.ADDITION and has_more:
            how = Effect.APPEND
            left = int(state.instruction.num_clauses) - int(state.clause)
            wanted, most = left + int(grounded.instruction.num_clauses), state.talk.viewer.shape[0]
            if wanted > most:
                raise ValueError(
                    f"{shorten(text)!r} makes {wanted} commands; at most {most} are held: say it "
                    "again when one of them is carried out"
                )
            if spoken.steps:
                raise ValueError(
                    f"{shorten(text)!r}: where the robot will stand when its task is done is not "
                    "known yet: say it when it is there"
                )
        area = state.belief.coverage.area
        check_measures(spoken, np.asarray(pose).tolist(), np.asarray(area).tolist())
        kind = label_of(about)
        is_answer = is_asked and len(spoken.goals) == 1 and kind in spoken.may_be(spoken.goals[0])
        is_again = said.kind == Kind.CORRECTION or is_answer
        out = self._ruled_out(state, said, grounded, text) if how is Effect.REPLACE else NONE
        joined = self._join(state, grounded, how=how, is_loose=is_again or how is Effect.APPEND)
        after = _tell(state, joined, pose, how=how)
        if out != NONE:
            after = _rule_out(after, jnp.int32(1 << out))
        if is_answer:  # one question is enough: what still fits best will do
            after = _choose_freely(after)
        kind = said.kind or (Kind.ANSWER if is_answer else Kind.COMMAND)
        gone, notes = () if out == NONE else (out,), notes + _dropped(state, after)
        return after, UtteranceOutcome(text=text, kind=kind, ruled_out=gone, notes=notes)

    def _join(
        self,
        state: NavigatorState,
        grounded: Grounded,
        *,
        how: Effect = Effect.REPLACE,
        is_loose: bool = True,
    ) -> Merged:
        """Merge the new reading with the dialogue state."""
        return join(
            state.instruction.readings,
            state.talk.words,
            grounded.instruction,
            grounded.spoken,
            is_new_task=how is Effect.REPLACE,
            is_loose=is_loose,
            is_asked=how is not Effect.INFORM,
        )

    def _about(self, state: NavigatorState) -> tuple[int, bool]:
        """Find the type of what has been spoken of, and whether the robot is at one of them."""
        at = int(state.talk.approached)
        if at != NONE:
            return type_at(state, at), True
        readings = state.instruction.readings
        best = int(np.argmax(np.asarray(readings.log_probability)))
        goal = int(np.asarray(state.talk.words.goal)[best, int(state.clause)])
        kind = NONE if goal == NONE else int(np.asarray(readings.mention_type)[best, goal])
        return (kind if kind >= 0 else NONE), False

    def _ruled_out(
        self, state: NavigatorState, said: Utterance, grounded: Grounded, text: str
    ) -> int:
        """Find the observed slot that a new task is not about; NONE where there is none."""
        spoken = grounded.spoken or Spoken()
        kind = spoken.goals[0] if spoken.goals else NONE
        at, last = int(state.talk.approached), int(state.previous_goal)
        slots = [slot for slot in (at, last) if slot != NONE]
        slots = [one for one in slots if label_of(type_at(state, one)) in spoken.may_be(kind)]
        if len(spoken.goals) == 1 and kind in spoken.others:
            if not slots:
                name = noun_of(kind, names_of(self.grounder))
                raise ValueError(
                    f"{shorten(text)!r}: no {name} has been approached yet, so there is no other: "
                    f"say which, as in 'the {name} by the cone'"
                )
            return slots[0]
        return at if said.is_not_that and at in slots else NONE

    def warm_up(self, state: NavigatorState) -> None:
        """Compile all that an utterance may do to a state, so that nobody waits for it."""
        grounded = Grounded(instruction=come_here(), annotations=())
        joined, slot = self._join(state, grounded), jnp.int32(0)
        for how in Effect:
            _tell(state, joined, state.belief.last_pose, how=how)
        _come_back(state, joined)
        _choose(state, slot)
        _rule_out(state, slot)
        _come_closer(state)
        _choose_freely(state)
        believed_pose(state)


def _acted(state: NavigatorState, heard: UtteranceOutcome, act: Act) -> _Updated:
    """Halt, or drop the task, as an utterance began that goes on without a command."""
    return speech_acts.apply_act(state, act), dataclasses.replace(heard, kind=_BY_ACT[act])


def check_measures(spoken: Spoken | None, pose: Sequence[float], area: Sequence[float]) -> None:
    """Refuse, with a ValueError, to move out of the operating area (host only)."""
    for end in () if spoken is None else spoken.steps:
        x, y, _ = seen_from(np.array(pose), np.array([[*end, 0.0]]))[0]
        if not (area[0] <= x <= area[1] and area[2] <= y <= area[3]):
            limits = ", ".join(f"{float(one):g}" for one in area)
            raise ValueError(
                f"that leads to ({x:.1f}, {y:.1f}), but the operating area is ({limits}): go less "
                "far, or start with a larger area"
            )


def _dropped(before: NavigatorState, after: NavigatorState) -> tuple[str, ...]:
    """Say how much of what was said found no room any more."""
    number = int(after.talk.words.num_dropped) - int(before.talk.words.num_dropped)
    if number <= 0:
        return ()
    return (f"{number} of what was said of the map earlier is forgotten: there is no room for it",)
