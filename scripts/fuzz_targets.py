"""Targets of ``fuzz.py``. To add one, append a ``Target`` to ``TARGETS``."""

import contextlib
import io
import json
import tempfile
import tomllib
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import numpy as np
from fuzz import TEXTS, Target

from jaxlangnav.cli import main as cli
from jaxlangnav.cli.output import Output, write_document
from jaxlangnav.experiments.shards import FileError, FileId, read_rows, write_rows
from jaxlangnav.experiments.summary import render, summarize_directory, summary_markdown
from jaxlangnav.experiments.sweep import MANIFEST, identity, read_manifest
from jaxlangnav.experiments.sweep_config import read_config
from jaxlangnav.grounding import AnnotationGrounder, Context
from jaxlangnav.grounding.weights import SHIPPED_WEIGHTS, load
from jaxlangnav.inputs.documents import read_text, shipped_file
from jaxlangnav.language.corpus import read_corpus
from jaxlangnav.language.grammar import Grammar
from jaxlangnav.language.lexicon import read_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.world.files import load_world, open_world, save_world, shipped_worlds, world_to_dict

LANGUAGE = resources.files("jaxlangnav.language") / "data"
SEEDS = tomllib.loads((Path(__file__).parent / "fuzz_seeds.toml").read_text("utf-8"))


def _texts(name: str) -> list[bytes]:
    return [text.encode() for text in SEEDS[name]]


def _worlds() -> list[bytes]:
    return [shipped_file("world", f"{name}.toml").read_bytes() for name in shipped_worlds()]


def _json_worlds() -> list[bytes]:
    opened: list[Any] = [open_world(name) for name in shipped_worlds()]
    return [json.dumps(world_to_dict(world), indent=1).encode() for world in opened]


def _world(text: bytes, folder: Path, *, suffix: str = "toml") -> None:
    """Load a world; if accepted, it is finite, printable, and survives a round trip."""
    path = folder / f"world.{suffix}"
    path.write_bytes(text)
    world = load_world(path)
    leaves = jax.tree.leaves((world.scenario, world.sensor))
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in leaves)
    assert (world.name + (world.instruction or "")).isprintable()
    save_world(world, folder / "again.toml")
    again = load_world(folder / "again.toml")
    for ours, theirs in zip(leaves, jax.tree.leaves(again.scenario), strict=False):
        assert np.array_equal(ours, theirs)


def _lexicon(text: bytes, folder: Path) -> None:
    """Read a custom lexicon; for every fiftieth accepted one build the grammar."""
    (folder / "words.toml").write_bytes(text)
    shipped = (LANGUAGE / "lexicon.toml").read_text("utf-8")
    lexicon = read_lexicon(shipped, read_text(folder / "words.toml", max_bytes=1 << 20))
    assert lexicon.entries["det"]["the",][0].senses == ()
    assert ("the",) not in lexicon.entries["type"]
    assert all(word.isprintable() for word in lexicon.vocabulary)
    if hash(text) % 50 == 0:
        Grammar((LANGUAGE / "grammar.txt").read_text("utf-8"), lexicon)


def _corpus_lines() -> list[bytes]:
    lines = (LANGUAGE / "corpus39.jsonl").read_bytes().splitlines()
    return sorted((line for line in lines if line.startswith(b"{")), key=len)[:4]


def _corpus(text: bytes, folder: Path) -> None:
    (folder / "corpus.jsonl").write_bytes(text)
    for example in read_corpus(folder / "corpus.jsonl"):
        for labels in example.worlds:
            positions = [position for _, *position in labels.world.objects]
            assert np.isfinite(np.array(positions, float)).all()
            assert np.isfinite(np.array(labels.world.robot, float)).all()


def _sweep(text: bytes, folder: Path) -> None:
    """Read a sweep configuration; if accepted, it can be serialized."""
    (folder / "sweep.toml").write_bytes(text)
    config = read_config(folder / "sweep.toml")
    json.dumps(config.document(), allow_nan=False).encode("utf-8")
    assert config.name.isprintable()


def _manifests() -> list[bytes]:
    settings = {"name": "range", "files": 2, "rows": 8, "worlds": ["1H1C"], "seeds": [0]}
    document = {
        "settings": settings,
        "jaxlangnav": "1.0",
        "libraries": {"jax": "0.10", "numpy": "2.0"},
        "models_sha256": "0" * 64,
        "device": {"platform": "cpu", "kind": "cpu", "count": 1},
    }
    return [json.dumps(document, indent=2).encode(), json.dumps({"settings": settings}).encode()]


def _episodes() -> dict[str, Any]:
    """Build eight episode rows of a world whose name contains markup and control characters."""
    count, world = 8, "a|b <b>**[red]\x1b[2J.toml"
    floats = dict.fromkeys(
        ("distance", "final_x", "final_y", "goal_distance", "mean_effective_sample_size"),
        np.linspace(1.0, 9.0, count, dtype=np.float32),
    )
    integers = dict.fromkeys(
        ("steps", "ending", "overflow", "degenerate", "faults", "contradictions"),
        np.arange(count, dtype=np.int32),
    )
    constants = {"world": world, "relation": "behind", "command": "go", "particles": 64, "seed": 0}
    return {
        **{name: [value] * count for name, value in constants.items()},
        "range": np.full(count, 3.0),
        "policy": ["informed", "faithful"] * (count // 2),
        "episode": [index // 2 for index in range(count)],
        "is_success": np.arange(count) % 2 == 0,
        **dict.fromkeys(("is_stopped", "is_valid"), np.ones(count, bool)),
        "known_distance": np.full(count, 5.0, np.float32),
        **floats,
        **integers,
    }


def _manifest(text: bytes, folder: Path) -> None:
    """Summarise a sweep with a mutated manifest; if accepted, all outputs are printable."""
    (folder / MANIFEST).write_bytes(text)
    sweep = identity(read_manifest(folder))
    shard = FileId(sweep=sweep, index=0, rows=8)
    write_rows(_episodes(), folder / "episodes-000000.parquet", shard)
    document = summarize_directory(folder)
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        Output(is_json=False).print(render(document))
        write_document(document)
    output.write(summary_markdown(document))
    assert all(line.isprintable() for line in output.getvalue().split("\n")), "it is not plain"
    assert "<b>" not in summary_markdown(document)


def _sentence(text: bytes, _: Path) -> None:
    document = parse(text.decode("utf-8", "surrogateescape")).to_dict()
    with contextlib.redirect_stdout(io.StringIO()):
        write_document(document)


def _commands() -> list[bytes]:
    """Build command lines, one quoted word per line, so that whole words are mutated too."""
    hostile = [["parse", t] for t in TEXTS] + [["follow", "x", "--world", t] for t in TEXTS]
    lines = [*SEEDS["command-line"], *hostile]
    return ["\n".join(f'"{w}"' for w in words).encode("utf-8", "replace") for words in lines]


def _shipped_weights() -> list[bytes]:
    return [shipped_file("grounding", SHIPPED_WEIGHTS).read_bytes()]


def _weights(text: bytes, folder: Path) -> None:
    """Load trained models; if accepted, their weights are finite."""
    (folder / "weights.npz").write_bytes(text)
    model = load(folder / "weights.npz")
    for part in (model.annotation, model.behavior):
        assert all(np.isfinite(weight).all() for weight in part.weights.values())
        assert np.isfinite(part.temperature)


@cache
def _valid_shard() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episodes-000000.parquet"
        return write_rows(_episodes(), path, FileId(sweep="0" * 64, index=0, rows=8)).read_bytes()


def _shard(text: bytes, folder: Path) -> None:
    path = folder / "episodes-000000.parquet"
    path.write_bytes(text)
    read_rows(path, sweep="0" * 64, index=0)
    assert text == _valid_shard(), "a damaged file passes for whole"


def _forms() -> list[bytes]:
    objects = [{"id": "a", "type": "hydrant"}, {"id": "b", "type": "cone"}]
    relations = [{"figure": "a", "relation": "behind", "landmark": "b"}]
    commands = [{"action": "navigate", "goal": {"region": "at", "thing": "a"}, "avoid": ["b"]}]
    reading = {"things": objects, "relations": relations, "commands": commands}
    uncertain = {"readings": [reading | {"probability": 0.7}, reading | {"probability": 0.3}]}
    return [json.dumps(form).encode() for form in ({"readings": [reading]}, uncertain)]


def _form(text: bytes, _: Path) -> None:
    grounder = AnnotationGrounder(("hydrant", "cone", "car"))
    grounded = grounder.ground(text.decode("utf-8", "surrogateescape"), Context(is_under_way=False))
    for leaf in jax.tree.leaves(grounded.instruction.clauses):
        assert np.isfinite(np.asarray(leaf)).all()


class CommandLineError(Exception):
    """Raised if the command line refuses its arguments; holds the whole standard error."""


def _run_checks_only(command: Any) -> int:
    """Run the part of a command that needs no compiled program."""
    output = Output(is_json=command.json)
    if type(command).__name__ == "Parse":
        document = command.run(output)
        if command.json:
            write_document(document)
        return 0
    check = getattr(command, "_check", None)
    if check is not None:
        check()
    return 0


def _command_line(text: bytes, folder: Path) -> None:
    """Run a command line in this process, up to compilation."""
    decoded = text.decode("utf-8", "surrogateescape").split("\n")
    words = [word.removeprefix('"').removesuffix('"') for word in decoded]
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out), contextlib.redirect_stderr(err),
        contextlib.chdir(folder), mock.patch.object(cli, "_run", _run_checks_only),
    ):  # fmt: skip
        code = cli.main(words)
    printed, errors = out.getvalue(), err.getvalue()
    assert all(line.isprintable() for line in (printed + errors).split("\n")), "it is not plain"
    assert not list(folder.iterdir()), "something was left behind"
    if code == 2:
        raise CommandLineError(errors.removesuffix("\n"))
    assert code == 0, f"exit code {code}: {errors}"


TARGETS = (
    Target(name="world", seeds=_worlds, call=_world, refusals=(ValueError,)),
    Target(
        name="world-json", seeds=_json_worlds, call=partial(_world, suffix="json"),
        refusals=(ValueError,),
    ),
    Target(name="lexicon", seeds=partial(_texts, "lexicon"), call=_lexicon, refusals=(ValueError,)),
    Target(name="corpus", seeds=_corpus_lines, call=_corpus, refusals=(ValueError,)),
    Target(name="sweep", seeds=partial(_texts, "sweep"), call=_sweep, refusals=(ValueError,)),
    Target(name="manifest", seeds=_manifests, call=_manifest, refusals=(ValueError,)),
    Target(name="shard", seeds=lambda: [_valid_shard()], call=_shard, refusals=(FileError,)),
    Target(name="weights", seeds=_shipped_weights, call=_weights, refusals=(ValueError,)),
    Target(name="form", seeds=_forms, call=_form, refusals=(ValueError,)),
    Target(
        name="sentence", seeds=partial(_texts, "sentence"), call=_sentence,
        refusals=(LanguageError,),
    ),
    Target(name="command-line", seeds=_commands, call=_command_line, refusals=(CommandLineError,)),
)  # fmt: skip
"""All fuzz targets."""
