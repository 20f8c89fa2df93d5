"""``jaxlangnav train`` and ``evaluate``: training and evaluation of language models (4.1)."""

import dataclasses
import shlex
from pathlib import Path
from typing import Any, Literal

import tyro

from jaxlangnav.cli.checks import File, check_file
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs, progress_bar
from jaxlangnav.inputs.limits import bounded, check_minimum, check_seed
from jaxlangnav.language.phrase import MIN_PROBABILITY


@dataclasses.dataclass(frozen=True, kw_only=True)
class Train:
    """Train a model from labelled sentences, and measure it on those held out.

    annotation: what a sentence says of a place nobody has seen. behavior: what it asks for among
    objects whose places are known. The model that is not trained is kept from --base. reader: what
    free speech stands for in the controlled language; docs/language.md has its corpus.

    Examples:
      jaxlangnav train annotation --out weights.npz
      jaxlangnav train behavior --base weights.npz --out weights.npz
      jaxlangnav train both --corpus my_corpus --out weights.npz --json
      jaxlangnav train reader --corpus readings.jsonl --out reader.npz
      jaxlangnav follow "go to the hydrant" --weights weights.npz
    """

    what: tyro.conf.Positional[Literal["annotation", "behavior", "both", "reader"]]
    """Which model."""
    corpus: File = None
    """A corpus file, or a folder with corpus.jsonl; the package's own if not given."""
    base: File = None
    """Weights that the other model comes from; the shipped ones if not given."""
    out: File = None
    """File to write, .npz; nothing is written if not given."""
    json: bool = False
    """Print one JSON document: sizes, seconds, accuracy on the hold-out, file."""

    def run(self, output: Output) -> Document:
        """Train, measure and write."""
        check_file("--out", self.out, ".npz")
        keep_compiled_programs()
        if self.what == "reader":
            return self._train_reader(output)
        from jaxlangnav.grounding.weights import load, save
        from jaxlangnav.training.shipped import MODELS, train_models

        kinds = MODELS if self.what == "both" else (self.what,)
        base = load(self.base)
        trained = train_models(self.corpus, kinds=kinds, base=base, on_progress=output.note)
        if self.out is not None:
            corpus_hash = trained.report["corpus"]
            save(self.out, trained.model, command=self._command, corpus_hash=corpus_hash)
        document = {**trained.report, "file": self.out}
        output.print(f"{document['sentences']} sentences, corpus {document['corpus']}")
        for name in kinds:
            report = document[name]
            output.print(
                f"{name}: {report['examples']} factors, {report['features']} features; "
                f"{report['steps']} steps in {report['train_s']:.2f} s "
                f"(compiled in {report['train_compile_s']:.1f} s)"
            )
            if "accuracy" in report:
                output.print(
                    f"  whole sentences right: {100 * report['accuracy']:.1f} % of the "
                    f"{report['held_out']} held out; calibration error "
                    f"{report['calibration_error']:.3f} at temperature {report['temperature']:.2f}"
                )
        message = f"Wrote {self.out}. Use it: jaxlangnav follow ... --weights FILE"
        output.print(message if self.out else "Nothing was written; --out FILE keeps the weights.")
        return document

    @property
    def _command(self) -> str:
        corpus = f" --corpus {shlex.quote(self.corpus.name)}" if self.corpus else ""
        return f"jaxlangnav train {self.what}{corpus}"

    def _train_reader(self, output: Output) -> Document:
        if self.base is not None:
            raise UsageError("--base is of the other models: leave it out for the reader")
        from jaxlangnav.language.reader.model import save_reader
        from jaxlangnav.training.reader import read_reader_corpus
        from jaxlangnav.training.shipped import train_shipped_reader

        rows = read_reader_corpus(self.corpus)
        model, report = train_shipped_reader(rows, on_progress=output.note)
        if self.out is not None:
            save_reader(self.out, model, command=self._command)
        output.print(
            "{sentences} sentences, {features} features, {labels} labels: {weights} weights, "
            "{loss:.3f} nats a sentence, in {train_s:.0f} s".format(**report)
        )
        message = f"Wrote {self.out}. Use it: JAXLANGNAV_READER=FILE jaxlangnav ..."
        output.print(message if self.out else "Nothing was written; --out FILE keeps the reader.")
        return {**report, "file": self.out}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Measure understanding by the paper's protocol: Table 1. Or score sentences of your own.

    39 labelled sentences, random splits of 67 to 33 percent, a sentence counts where every symbol
    at its root is right. The three commands of Table 2 are in none of them.

    With --sentences: how many of a file's sentences are read as labelled, refused, and read
    wrongly, by construction, and the worst of them. docs/language.md has the format.

    Examples:
      jaxlangnav evaluate
      jaxlangnav evaluate --splits 200 --json
      jaxlangnav evaluate --sentences tests/sentences.jsonl
      jaxlangnav evaluate --sentences mine.jsonl --rewrites recorded.jsonl --temperature 1.5
    """

    sentences: File = None
    """Labelled sentences, one JSON object a line: score these, and leave Table 1 out."""
    least_probability: float = MIN_PROBABILITY
    """Of --sentences: minimum probability of the trained reader's rewriting, from 0 to 1."""
    rewrites: File = None
    """Recorded paraphrases of them by a language model: score the graph, these, and both."""
    temperature: float = 1.0
    """Temperature: the log-probabilities of the paraphrases are divided by it."""
    fit_temperature: bool = False
    """Fit the temperature to these sentences first; take it to others with --temperature."""
    splits: int = 8
    """Random splits; the paper has 8."""
    seed: int = 0
    """Of the splits."""
    beams: tuple[int, ...] = (4, 1, 16)
    """Beam widths of the search; the first is that of the table and of the seconds."""
    beam_only: bool = False
    """Leave out the exact search, which goes on until no other set of symbols can be likelier."""
    json: bool = False
    """Print one JSON document: by model accuracy, interval, seconds; the paper's rows."""

    def run(self, output: Output) -> Document:
        """Run the protocol and print the table beside the paper's."""
        check_minimum(2, **{"--splits": self.splits})
        check_seed(self.seed, "--seed")
        if not self.beams:
            raise UsageError("--beams needs at least one width")
        for beam in self.beams:
            check_minimum(1, **{"--beams": beam})
        bounded(self.least_probability, 0.0, 1.0, "--least-probability", "give a share")
        if self.rewrites is not None and self.sentences is None:
            raise UsageError("--rewrites needs --sentences, the labelled sentences themselves")
        if self.rewrites is None and (self.fit_temperature or self.temperature != 1.0):
            raise UsageError("--temperature and --fit-temperature are of --rewrites: give a file")
        if self.sentences is not None:
            return self._score(self.sentences, output)
        keep_compiled_programs()
        from jaxlangnav.experiments.table1 import evaluate, table_1

        kwargs: dict[str, Any] = {"splits": self.splits, "seed": self.seed, "beams": self.beams}
        with progress_bar("splits", self.splits) as advance:
            document = evaluate(**kwargs, is_exact=not self.beam_only, on_progress=advance)
        output.print(table_1(document).text())
        return document

    def _score(self, path: Path, output: Output) -> Document:
        """Score a file of labelled sentences, with and without recorded rewrites if given."""
        from jaxlangnav.task.labelled import read_sentences

        sentences = read_sentences(path)
        keep_compiled_programs()
        from jaxlangnav.grounding.rewrites import RecordedRewrites, check_temperature
        from jaxlangnav.grounding.weights import load_shipped
        from jaxlangnav.task import evaluation

        document: dict[str, Any] = {"file": str(path)}
        model = load_shipped()
        if self.rewrites is None:
            kwargs: dict[str, Any] = {"least_probability": self.least_probability}
            with progress_bar("sentences", len(sentences)) as advance:
                scores = evaluation.score_sentences(sentences, model, advance, **kwargs)
            document |= evaluation.summarize_scores(scores)
            table, lines = evaluation.render_scores(document)
        else:
            check_temperature(self.temperature)
            recorded = RecordedRewrites(self.rewrites)
            usable = evaluation.select_recorded(sentences, recorded)
            if num_missing := len(sentences) - len(usable):
                output.note(f"note: {num_missing} sentences were not recorded; left out")
            fit = evaluation.fit_recorded(usable, recorded, model) if self.fit_temperature else None
            temperature = self.temperature if fit is None else fit.temperature
            document |= {"rewrites": str(self.rewrites), "fit": fit and dataclasses.asdict(fit)}
            with progress_bar("sentences", len(usable) * len(evaluation.VARIANTS)) as advance:
                document |= evaluation.score_variants(usable, recorded, model, temperature, advance)
            table, lines = evaluation.render_variants(document, fit)
        output.print(table)
        for line in lines:
            output.print(line)
        return document
