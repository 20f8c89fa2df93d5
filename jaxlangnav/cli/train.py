"""``jaxlangnav train``: the correspondence models, from a corpus (sections 3.1, 3.3 and 4.1)."""

import dataclasses
import shlex
from typing import Literal

import tyro

from jaxlangnav.cli.checks import File, check_file
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs


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
        trained = train_models(
            self.corpus, kinds=kinds, base=load(self.base), on_progress=output.note
        )
        if self.out is not None:
            corpus = f" --corpus {shlex.quote(self.corpus.name)}" if self.corpus else ""
            save(
                self.out,
                trained.model,
                command=f"jaxlangnav train {self.what}{corpus}",
                corpus_hash=trained.report["corpus"],
            )
        document = {**trained.report, "file": self.out}
        output.say(f"{document['sentences']} sentences, corpus {document['corpus']}")
        for kind in kinds:
            report = document[kind]
            output.say(
                f"{kind}: {report['examples']} factors, {report['features']} features; "
                f"{report['steps']} steps in {report['train_s']:.2f} s "
                f"(compiled in {report['train_compile_s']:.1f} s)"
            )
            if "accuracy" in report:
                output.say(
                    f"  whole sentences right: {100 * report['accuracy']:.1f} % of the "
                    f"{report['held_out']} held out; calibration error "
                    f"{report['calibration_error']:.3f} at temperature {report['temperature']:.2f}"
                )
        wrote = f"Wrote {self.out}. Use it: jaxlangnav follow ... --weights FILE"
        output.say(wrote if self.out else "Nothing was written; --out FILE keeps the weights.")
        return document

    def _train_reader(self, output: Output) -> Document:
        if self.base is not None:
            raise UsageError("--base is of the other models: leave it out for the reader")
        from jaxlangnav.language.reader.model import save_reader
        from jaxlangnav.training.reader import ReaderConfig, read_reader_corpus, train_reader

        examples = read_reader_corpus(self.corpus)
        model, report = train_reader(examples, config=ReaderConfig())
        if self.out is not None:
            corpus = f" --corpus {shlex.quote(self.corpus.name)}" if self.corpus else ""
            save_reader(self.out, model, command=f"jaxlangnav train reader{corpus}")
        output.say(
            "{sentences} sentences, {features} features, {labels} labels: {weights} weights, "
            "{loss:.3f} nats a sentence, in {train_s:.0f} s".format(**report)
        )
        if self.out is not None:
            output.say(f"Wrote {self.out}. Use it: JAXLANGNAV_READER=FILE jaxlangnav ...")
        else:
            output.say("Nothing was written; --out FILE keeps the reader.")
        return {**report, "file": self.out}
