"""Generate the corpora: sentences from templates, sampled worlds, labels of ``corpus_labels.py``.

    python scripts/make_corpus.py            # corpus.jsonl from corpus_templates.txt
    python scripts/make_corpus.py --only-39  # corpus39.jsonl from corpus39.txt

Each template states what its sentence must mean; a sentence whose composed labels say anything
else stops the script, so a fault of parser or rules cannot slip into the labels unseen.
Worlds are drawn until the command has an answer there, and, where the world holds two things
of the figure's type, until only one of them is meant: then the relation decides.
"""

import json
import random
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
from corpus_labels import annotate, behave, rank

import jaxlangnav.language.parser
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.phrase import Parse

FOLDER = Path(__file__).parent
DATA = Path(jaxlangnav.language.__file__).parent / "data"
MAX_DRAWS = 4000
WORLDS_PER_SENTENCE = 2
FILES = {"corpus39": "corpus39.txt", "corpus": "corpus_templates.txt"}
WORDS = tomllib.loads((FOLDER / "corpus_words.toml").read_text("utf-8"))


class Slots:
    """Fills the slots of one sentence at random, and records their meanings."""

    def __init__(self, rng: random.Random, *, is_test: bool) -> None:
        """Start without meanings; test sentences may use the words after a bar."""
        self.rng, self.is_test, self.meaning = rng, is_test, dict[str, str]()

    def choose(self, name: str) -> str:
        """Sample an expression from a list."""
        common, _, held_out = WORDS["words"][name].partition("|")
        is_held_out = self.is_test and held_out.split() and self.rng.random() < 0.3
        return self.rng.choice((held_out if is_held_out else common).split()).replace("_", " ")

    def fill(self, slot: str) -> str:
        """Fill one slot; a type slot used twice in a template keeps its type."""
        if slot in ("a", "b", "c", "d"):
            if slot not in self.meaning:
                unused = [t for t in WORDS["types"] if t not in self.meaning.values()]
                self.meaning[slot] = self.rng.choice(unused)
            return self.choose(self.meaning[slot])
        if (relation := WORDS["relations"].get(slot)) is None:
            return self.choose(slot)
        names, weights = list(relation["weights"]), list(relation["weights"].values())
        self.meaning[slot] = self.rng.choices(names, weights)[0]
        return self.choose(relation["prefix"] + self.meaning[slot])


def expand(pattern: str, slots: Slots) -> str:
    """Fill a pattern's slots with words."""
    words = re.sub(r"{(.*?)}", lambda match: slots.fill(match[1]), pattern).split()
    for index, word in enumerate(words[:-1]):
        if word in ("a", "an") and words[index + 1][0] in "aeiou":
            words[index] = "an"
    return " ".join(words)


def expected(root: str, slots: Slots) -> frozenset[str]:
    """Substitute the slots' meanings into the symbols that a template states."""
    symbols = set()
    for symbol in root.replace("-", "").split():
        kind, _, rest = symbol[:-1].partition("(")
        arguments = [slots.meaning.get(argument, argument) for argument in rest.split(",")]
        symbols.add(f"{kind}({','.join(arguments)})")
    return frozenset(symbols)


def draw_world(parse: Parse, types: list[str], rng: random.Random) -> PlacedWorld:
    """Sample objects: those named, often twice, and others, clustered in pairs."""
    max_rank = max(rank(p) for root in parse.clauses for p in root.walk())
    types_drawn = [name for name in types for _ in range(2 if rng.random() < 0.55 else 1)]
    types_drawn += types[:1] * max(0, max_rank - 1)
    others = [name for name in load_lexicon().type_names if name not in types]
    types_drawn += [rng.choice(others) for _ in range(rng.randint(0, 2))]
    types_drawn = types_drawn[:8]
    rng.shuffle(types_drawn)
    robot = (0.0, 0.0, 0.0)
    if rng.random() < 0.5:
        x, y, heading = rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(-3.1, 3.1)
        robot = (round(x, 2), round(y, 2), round(heading, 2))
    positions: list[tuple[float, float]] = []
    for _ in types_drawn:
        position = robot[:2]
        for _ in range(50):
            if positions and rng.random() < 0.7:
                x, y = rng.choice([*positions, robot[:2]])
                distance, angle = rng.uniform(1.2, 4.0), rng.uniform(-np.pi, np.pi)
                position = (x + distance * np.cos(angle), y + distance * np.sin(angle))
            else:
                position = (robot[0] + rng.uniform(-12, 12), robot[1] + rng.uniform(-12, 12))
            gaps = [np.hypot(position[0] - x, position[1] - y) for x, y in [*positions, robot[:2]]]
            if min(gaps) > 1.0:
                break
        positions.append(position)
    rows = zip(types_drawn, positions, strict=True)
    objects = tuple((name, round(float(x), 2), round(float(y), 2)) for name, (x, y) in rows)
    previous = None
    if "other" in parse.instruction:
        candidates = [i for i, (name, _, _) in enumerate(objects) if not types or name == types[0]]
        previous = rng.choice(candidates) if candidates else None
    return PlacedWorld(objects=objects, robot=robot, previous=previous)


def with_previous(parse: Parse, world: PlacedWorld) -> PlacedWorld:
    """Set the previous goal if the sentence refers back to its first command's goal."""
    words = [word for root in parse.clauses for word in root.all_words()]
    if not any("same" in word.senses for word in words):
        return world
    goals = [s for s in behave(parse.clauses[0], world)[-1] if s.startswith("goal")]
    slots = {goal.split(",")[1][:-1] for goal in goals}
    if len(slots) != 1 or "robot" in slots:
        return world
    return world._replace(previous=int(slots.pop()))


def labels_in(
    parse: Parse, world: PlacedWorld, *, is_among_part: bool = True
) -> tuple[list[list[frozenset[str]]], bool]:
    """Label all clauses in a world, and test whether the world fits the sentence."""
    all_labels, fits = [], True
    for root, kind in zip(parse.clauses, parse.kinds, strict=True):
        labels = list(behave(root, world, is_among_part=is_among_part))
        all_labels.append(labels)
        goals = sorted(s for s in labels[-1] if s.startswith("goal"))
        constraints = [s for s in labels[-1] if s.startswith("constraint")]
        if kind == "command":
            has_action = any(s.startswith("action") for s in labels[-1])
            fits &= bool(goals) if has_action else bool(constraints)
            fits &= len(goals) <= 1 or not is_restricted(labels)
        at_object = [s for s in goals if s.startswith("goal(at,")]
        if len(at_object) == 1:
            world = world._replace(previous=int(at_object[0][8:-1]))
    return all_labels, fits


def is_restricted(labels: list[frozenset[str]]) -> bool:
    """Test whether a noun phrase denotes more objects than the command's goals."""
    goals = {s for s in labels[-1] if s.startswith("goal(at")}
    mentioned = {s for symbols in labels for s in symbols if s.startswith("object")}
    return bool(goals) and len(mentioned) > len(goals)


def worlds_for(parse: Parse, types: list[str], rng: random.Random, count: int) -> list[dict]:
    """Sample worlds in which the instruction can be followed, the first with a distractor."""
    worlds: list[dict] = []
    roots = [annotate(root)[0][-1] for root in parse.clauses]
    is_placed = any(
        s.startswith("relation") and s[9:].startswith(types[0]) for r in roots for s in r
    )
    for _ in range(MAX_DRAWS):
        world = with_previous(parse, draw_world(parse, types, rng))
        labels, fits = labels_in(parse, world)
        # The graph knows ranks among all of a type only: worlds in which that makes no difference.
        fits &= labels_in(parse, world, is_among_part=False)[0] == labels
        present = [kind for kind, _, _ in world.objects]
        has_distractor = not is_placed or present.count(types[0]) > 1
        if not fits or (not worlds and not has_distractor):
            continue
        entry = {"objects": [*map(list, world.objects)], "robot": list(world.robot)}
        entry |= {"previous": world.previous, "behavior": [[*map(sorted, row)] for row in labels]}
        worlds.append(entry)
        if len(worlds) == count:
            return worlds
    raise SystemExit(f"no world fits '{parse.instruction}'")


def record(text: str, template: str, split: str, want: list[frozenset[str]], seed: str) -> dict:
    """Build the JSON document of one sentence, checked against its template's symbols."""
    parse = jaxlangnav.language.parser.parse(text, is_rewritten=False)
    rng = random.Random(seed + text)
    clauses = []
    if parse.unknown_words:
        raise SystemExit(f"{template}: '{text}' has unknown words {parse.unknown_words}")
    if len(parse.clauses) != len(want):
        raise SystemExit(f"{template}: '{text}' has {len(parse.clauses)} clauses")
    for root, kind, symbols in zip(parse.clauses, parse.kinds, want, strict=True):
        annotation, ranks = annotate(root)
        if annotation[-1] != symbols:
            raise SystemExit(f"{template}: '{text}' means {annotation[-1]}, not {symbols}: {root}")
        clause = {"kind": kind, "phrases": [phrase.head for phrase in root.walk()]}
        clause |= {"annotation": [*map(sorted, annotation)], "rank": list(ranks)}
        clauses.append(clause)
    types = [s[5:] for root in parse.clauses for w in root.all_words() for s in w.senses
             if s.startswith("type:")]  # fmt: skip
    is_command = "command" in parse.kinds
    worlds = worlds_for(parse, list(dict.fromkeys(types)), rng, WORLDS_PER_SENTENCE)
    return {
        "text": text, "template": template, "split": split, "clauses": clauses,
        "worlds": worlds if is_command else [],
    }  # fmt: skip


def from_templates(path: Path) -> list[dict]:
    """Expand a file of templates."""
    records: list[dict] = []
    texts: set[str] = set()
    for line in path.read_text("utf-8").splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        name, split, count, pattern, root = (part.strip() for part in line.split("|"))
        rng = random.Random(name)
        num_made = tries = 0
        while num_made < int(count) and tries < 400:
            tries += 1
            slots = Slots(rng, is_test=split == "test")
            text = expand(pattern, slots)
            if text in texts or text in WORDS["evaluated"]:
                continue
            texts.add(text)
            symbols = [expected(part, slots) for part in root.split(";")]
            records.append(record(text, name, split, symbols, name))
            num_made += 1
        print(f"{name}: {num_made}", file=sys.stderr)
    return records


def write(path: Path, records: list[dict]) -> None:
    """Write one JSON document a line."""
    lines = [json.dumps(item, separators=(",", ":")) for item in records]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{path.name}: {len(records)} instructions", file=sys.stderr)


def main() -> None:
    """Write the requested corpora."""
    only = [name for name in FILES if f"--only-{name[6:]}" in sys.argv]
    for name in only or FILES:
        write(DATA / f"{name}.jsonl", from_templates(FOLDER / FILES[name]))


if __name__ == "__main__":
    main()
