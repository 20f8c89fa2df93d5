"""What an order is asked with and how it is worded, put into the words of the grammar (3.1).

"Would it be possible for you to have a wander down to the bench that is tucked away just behind the
kiosk" has an order that the grammar knows: "go to the bench behind the kiosk". A request is made of
a closed class of words, a verb of motion or of rest is one of an open class, and how a thing stands
or how exactly does not tell where.
"""

from collections.abc import Sequence
from functools import cache

from jaxlangnav.language.clauses import (
    DETERMINERS,
    Things,
    gist_words,
    leading,
    order_at,
    relation_at,
    verb_at,
)
from jaxlangnav.language.lexicon import ing_form, load_lexicon
from jaxlangnav.language.nouns import command_verbs

_LONGEST_REQUEST = 18
_TOWARDS = ("to", "toward", "towards")
_AT = ("at", "by")
_BARE = ("go", "head", "drive", "walk", "run", "move")
"""Verbs after which who speaks another language leaves out "to the"."""
_WEAK = frozenset({"be", "get", "have", "like", "do", "let"})
"""Verbs that may belong to the request: "could you be so kind"."""
_NAMING = DETERMINERS | {"one", "in", "at", "of", "is"}
"""Words after which a verb is a noun: "the stop"."""
_ASKED = frozenset({"you", "possible", "somebody", "someone", "anyone", "anybody"})
"""Whom a request sets its polite condition: "if you could"."""
_SPEAKERS = frozenset({"i", "we", "im", "ive"})
_WISHES = frozenset({"want", "wanna", "need", "like", "love", "gotta", "must", "should", "wish"})
"""What "I" may say of going somewhere and ask for it: "I will" only tells."""
_LOADS = DETERMINERS - {"a", "an", "any"}
_QUESTIONS = frozenset({"did", "does", "has", "have", "had", "are", "is", "were", "was"})
_CONDITIONS = frozenset({"if", "when", "whenever", "whether", "once"})
_MIGHT = frozenset({"could", "would", "can", "might", "may", "to", "please", "possibly"})
"""What a polite condition ends with: "if you could"; "if you" is one."""


def size_of_request(words: Sequence[str], things: Things) -> int:
    """Count the words before an order that only ask for it: "would it be possible for you to".

    Args:
        words: of a clause.
        things: what the detector tells apart.

    Returns:
        The count; 0 where nothing asks, or what asks could deny or set a condition.
    """
    lists = gist_words().words
    words, request = with_bases(words), lists["request"]
    all_verbs = gist_words().all_verbs
    limit = next((i for i, word in enumerate(words) if word not in request), len(words))
    for index in range(1, min(limit, _LONGEST_REQUEST, len(words) - 1) + 1):
        following = words[index + 1] if index + 1 < len(words) else ""
        is_mind = words[index] == "mind" and following in all_verbs
        if order_at(words, index, things) and not is_mind and _asks(words, index, things):
            return index
    return 0


@cache
def _bases() -> dict[str, str]:
    """List the verbs by their forms in -ing."""
    return {ing_form(verb): verb for verb in gist_words().all_verbs}


def with_bases(words: Sequence[str]) -> list[str]:
    """Put verbs in -ing that an order may stand in into their plain form: "mind bringing"."""
    gerunds, plain = gist_words().words["gerunds"], list(words)
    for index in range(1, len(plain)):
        if plain[index - 1] in gerunds:
            plain[index] = _bases().get(plain[index], plain[index])
    return plain


def _asks(words: Sequence[str], index: int, things: Things) -> bool:
    """Tell whether words before an order only ask for it."""
    if words[0].split("'")[0] in _SPEAKERS and _ASKED.isdisjoint(words[:index]):
        # What "I" want to do is asked of the robot only where it names a place.
        after = words[index:]
        verbs = gist_words().verbs
        is_going = after[0] in verbs["motion"] | verbs["rest"] | command_verbs()
        is_wish = not _WISHES.isdisjoint(words[:index])
        if not (is_going and is_wish) or not any(map(things.has, after)):
            return False
    before = _without_phrases(list(words[:index]), "asking")
    if (words[index] in _WEAK and index < 2) or before[-1] in _NAMING:
        return False
    is_question = before[0] in ("should", "must", "do") and before[1:2] in (["i"], ["we"], ["you"])
    if is_question or before[0] in _QUESTIONS or before[-1] in gist_words().words["doers"]:
        return False  # "did you", "i put": who does it, or has done it
    if not gist_words().words["denials"].isdisjoint(before):
        return False
    is_polite = not _ASKED.isdisjoint(before) and before[-1] in _MIGHT
    return _CONDITIONS.isdisjoint(before) or is_polite


def _without_phrases(words: list[str], name: str) -> list[str]:
    """Put "you" in the place of phrases that deny nothing: "won't you"."""
    for phrase in gist_words().phrases[name]:
        for index in range(len(words) - len(phrase) + 1):
            if tuple(words[index : index + len(phrase)]) == phrase:
                words[index : index + len(phrase)] = ["you"]
                break
    return words


def plain_verb(
    words: Sequence[str], things: Things, *, is_spoken_of: bool = False
) -> tuple[int, int, str] | None:
    """Find the verb of an order that the grammar need not have, and what it is read as.

    Args:
        words: of a clause, a request before it left out.
        things: what the detector tells apart.
        is_spoken_of: a thing has been named before, so that "it" is no load of the robot's.

    Returns:
        Its first word, one after its last, and the words to put there; None for none.
    """
    first = next((i for i, word in enumerate(words) if word not in leading()), len(words))
    if first >= len(words) or _avoids(words, first):
        return None
    if is_spoken_of and gist_words().words["cargo"].intersection(words[first + 1 : first + 2]):
        return None
    for read in (_carried, _taken, _moved, _sought, _onward):
        found = read(words, first, things)
        if found is not None:
            return first, *found
    return None


def _avoids(words: Sequence[str], first: int) -> bool:
    """Tell whether a verb says where not to be: "stay away from"."""
    avoiding = load_lexicon().entries["avoid"]
    return any(tuple(words[first : first + size]) in avoiding for size in range(1, 6))


def _goes_on(words: Sequence[str], index: int) -> int:
    """Skip words that say roughly which way: "on over there"."""
    particles = gist_words().words["particles"]
    while index < len(words) and words[index] in particles and not relation_at(words, index):
        if words[index] == "the" and words[index + 1 : index + 2] != ["way"]:
            break
        index += 1
    return index


def _moved(words: Sequence[str], first: int, things: Things) -> tuple[int, str] | None:
    """Read a verb of motion or of rest: "mosey on down to", "lounge about behind"."""
    verbs, verb = gist_words().verbs, words[first]
    index = first + 1
    index += words[index : index + 1] != [] and words[index] in gist_words().words["objects"]
    after = _goes_on(words, index)
    following = words[after] if after < len(words) else ""
    if verb in verbs["motion"]:
        if following in _TOWARDS:
            return after + 1, "go to"
        if relation_at(words, after) and verb not in ("make", "get"):
            return after, "go"
        if verb in _BARE and after == first + 1 and things.name_at(words, after):
            return after, "go to the"
    is_placed = bool(relation_at(words, after)) or following in _AT
    return (after, "stop") if verb in verbs["rest"] and is_placed else None


def _onward(words: Sequence[str], first: int, things: Things) -> tuple[int, str] | None:
    """Read what leaves the verb out: "off to the barn", "back over to the truck"."""
    after = _goes_on(words, first)
    is_onward = after > first and words[after : after + 1] == ["to"]
    return (after + 1, "go to") if is_onward and words[after + 1 : after + 2] != [] else None


def _sought(words: Sequence[str], first: int, things: Things) -> tuple[int, str] | None:
    """Read a visit, or a search for somebody: "check out the", "fetch me up the"."""
    verbs, verb, after = gist_words().verbs, words[first], first + 1
    if verb in verbs["visiting"]:
        after += words[after : after + 1] in (["out"], ["on"], ["over"])
        is_named = words[after : after + 1] != [] and words[after] in DETERMINERS
        return (after, "visit") if is_named else None
    if verb in verbs["seeking"]:
        after += words[after : after + 1] in (["me"], ["us"])
        after += words[after : after + 1] in (["for"], ["out"], ["up"])
        is_named = words[after : after + 1] != [] and words[after] in DETERMINERS
        is_asked = after > first + 1 or verb == "search"
        return (after, "find") if is_named and is_asked else None
    return None


def _taken(words: Sequence[str], first: int, things: Things) -> tuple[int, str] | None:
    """Read a light verb with its noun: "have a little wander down to"."""
    index = first + 1
    if words[first] not in gist_words().verbs["light"] or words[index : index + 1] not in (
        ["a"], ["the"], ["your"], ["another"],
    ):  # fmt: skip
        return None
    for end in range(index + 2, min(index + 4, len(words))):
        after = _goes_on(words, end)
        is_way = not gist_words().words["ways"].isdisjoint(words[index:end])
        if words[after : after + 1] == ["to"] and not (is_way or things.bear(words[index:end])):
            return after + 1, "go to"
    return None


def _carried(words: Sequence[str], first: int, things: Things) -> tuple[int, str] | None:
    """Read a verb with what is taken along: "bring me over to", "leave the mail at"."""
    verbs, verb = gist_words().verbs, words[first]
    index = first + 1 + (words[first + 1 : first + 2] == ["off"])
    end = _end_of_load(words, index, things)
    if not end or verb not in verbs["transport"] | verbs["leaving"]:
        return None
    after = _goes_on(words, end)
    if verb in verbs["transport"] and words[after : after + 1] == ["to"]:
        return after + 1, "go to"
    is_placed = relation_at(words, after) or words[after : after + 1] in (["at"], ["by"])
    return (after, "stop") if is_placed else None


def _end_of_load(words: Sequence[str], index: int, things: Things) -> int:
    """Find the end of what is taken along; 0 where it is a thing told apart, or nothing."""
    lists = gist_words().words
    if index >= len(words):
        return 0
    if words[index] in lists["objects"] | lists["cargo"]:
        return index + 1
    if words[index] not in _LOADS:
        return 0
    for end in range(index + 2, min(index + 5, len(words))):
        after = _goes_on(words, end)
        if words[after : after + 1] in (["to"], ["at"], ["by"]) or relation_at(words, after):
            is_way = not lists["ways"].isdisjoint(words[index:end])
            return 0 if is_way or things.bear(words[index:end]) else end
    return 0


def standing_spans(words: Sequence[str], things: Things) -> list[tuple[int, int]]:
    """Find what says how a thing stands where it is, and how exactly: "tucked away just behind".

    Args:
        words: of a clause.
        things: what the detector tells apart.

    Returns:
        First word, and one after the last, of each span that can be left out; the last first.
    """
    spans: list[tuple[int, int]] = []
    for index in range(len(words) - 1, 1, -1):
        is_inner = any(relation_at(words, i) > index - i for i in range(max(index - 4, 0), index))
        if not relation_at(words, index) or is_inner or (spans and index >= spans[-1][0]):
            continue
        first = _begin_of_standing(words, index, things)
        if 0 < first < index:
            spans.append((first, index))
    return spans


def _begin_of_standing(words: Sequence[str], index: int, things: Things) -> int:
    """Find where the words begin that say how a thing stands, before its relation."""
    lists = gist_words().words
    while index > 1 and words[index - 1] in lists["degrees"]:
        index -= 1
    before = words[index - 1]
    is_participle = before.endswith(("ing", "ed")) and len(before) > 4
    is_standing = (is_participle or before in lists["standing"]) and not (
        before in lists["relating"] or things.has(before) or verb_at(words, index - 1)
    )
    return index - 1 if is_standing and index > 2 else index
