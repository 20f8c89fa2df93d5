"""``jaxlangnav reproduce``: experiments of the paper beside its printed numbers (section 4)."""

import dataclasses
import shlex
from typing import Any, ClassVar, Literal

import tyro

from jaxlangnav.cli import checks
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs
from jaxlangnav.cli.settings import apply, read_options
from jaxlangnav.inputs.limits import check_minimum, check_seed

_DEFAULT_EPISODES = {"robustness": 500}
_SETTING_GROUPS = {"table1": (), "fig3": (), "time": ("params",), "conversation": ("params",)}
_SETTING_GROUPS |= {"robustness": ("params",), "table3": ()}
"""Groups of settings that an experiment uses; the other experiments use all of them."""
_EXPERIMENTS_OF_OPTION = {
    "trials": ("table3",), "extra": ("table2", "all"), "ranges": ("table2", "fig5", "all"),
}  # fmt: skip
_ALLOWED_POLICIES = {"conversation": ("informed",), "table3": ("informed", "faithful")}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Run an experiment of the paper and set it beside the printed numbers.

    table1: how often sentences are understood. table2: success and distance by world and command,
    and how well the belief is calibrated. fig1: the belief over time. fig3: the factor graph.
    fig4: the value function over time. fig5: success and distance against the sensing range.
    unknowns: faithful with what the paper leaves open set otherwise, one thing at a time: what
    explains its figures? conversation: what a person's corrections, answers and statements are
    worth, of informed. time: where a decision cycle's time goes. table3: robots with bodies, in
    physics with rendered cameras. robustness: places unlike the paper's: crowds, bystanders, false
    detections, wrong labels, misses, false sentences, areas of 8 to 60 m. all: the paper's
    experiments but table3, and one page, report.html; it goes on where it was interrupted.

    Policies: informed (ours), faithful (the paper's), frontier (nearest frontier, no language),
    lawnmower (a sweep of the area), arc (a sweep that knows by what law the worlds are drawn),
    known (the map is known). All of them run in the same worlds with the same noise. The numbers of
    filter, planner, detector and motion can be set, as in --params.planner.discount 0.9 or
    --sensor.noise "20 cm": see --help-params.

    Examples:
      jaxlangnav reproduce all --out results
      jaxlangnav reproduce table2 --policy faithful --episodes 1000 --out results
      jaxlangnav reproduce table2 --extra --ranges 2,3,10,15
      jaxlangnav reproduce fig4 --out results
      jaxlangnav reproduce table2 --json > table2.json
      jaxlangnav reproduce table3 --trials 10 --out robots
    """

    SETTINGS: ClassVar = ("params", "sensor", "motion")

    what: tyro.conf.Positional[
        Literal[
            "table1", "table2", "table3", "fig1", "fig3", "fig4", "fig5", "unknowns",
            "conversation", "robustness", "time", "all",
        ]
    ]  # fmt: skip
    """Which experiment."""
    episodes: checks.OptionalInt = None
    """Runs a row; 100, and 500 in robustness, if not given."""
    policy: str = "all"
    """One policy, several with commas between, or all; fig1 and fig4 show faithful if not given."""
    trials: checks.OptionalInt = None
    """In table3, trials of each row; 10 if not given. Those that DIR holds are run again only if
    they crashed."""
    extra: bool = False
    """In table2, rows that the paper lacks as well: 2H2C, and three hydrants or three cones."""
    ranges: checks.Ranges = None
    """Sensing ranges in place of those of table2's rows and of fig5, with commas between."""
    seed: checks.OptionalInt = None
    """Root seed of worlds and noise; 0, and 3000 in unknowns, if not given."""
    particles: checks.OptionalInt = None
    """Hypotheses of the map kept at once; 64, and 256 in fig1 and fig4, if not given."""
    out: checks.Folder = None
    """Where to write episodes (Parquet), tables (Markdown), manifests, figures and the report."""
    json: bool = False
    """Print one JSON document: rows, paper, wall_s, compile_s; for all, one by experiment."""
    settings: tyro.conf.Suppress[Any] = None

    def run(self, output: Output) -> Document:
        """Run the experiment, print its table and write the files."""
        self._check()
        keep_compiled_programs()
        from jaxlangnav.cli import reproduction
        from jaxlangnav.cli.study import Settings
        from jaxlangnav.experiments.experiment import Options
        from jaxlangnav.experiments.paper import SENSING_RANGES
        from jaxlangnav.experiments.policies import POLICY_NAMES, check_policies
        from jaxlangnav.inputs.limits import LENGTH
        from jaxlangnav.messages import check_sensor, default_motion, default_sensor
        from jaxlangnav.navigator import check
        from jaxlangnav.planner.config import SHIPPED
        from jaxlangnav.task.follow import navigator_params

        range_texts = [] if self.ranges is None else self.ranges.split(",")
        ranges = tuple(LENGTH.read(text.strip(), "--ranges") for text in range_texts)
        names = [name.strip() for name in self.policy.split(",") if name.strip()]
        values = read_options(self.settings, self.SETTINGS)
        max_range = min(SENSING_RANGES) if self.what in ("fig5", "all") else 3.0
        check_sensor(apply(default_sensor(min(ranges, default=max_range)), values, "sensor"))
        params = apply(navigator_params(), values, "params")
        policies = check_policies(list(POLICY_NAMES) if names == ["all"] else names)
        for policy in sorted(SHIPPED.keys() & set(policies)):
            check(params, policy=SHIPPED[policy])
        settings = Settings(
            options=Options(
                episodes=self.episodes or _DEFAULT_EPISODES.get(self.what, 100),
                policies=policies,
                seed=self.seed or 0,
                num_particles=self.particles or 64,
                params=params,
                sensor=apply(default_sensor(), values, "sensor"),
                motion=apply(default_motion(), values, "motion"),
            ),
            params=params,
            ranges=ranges,
            values=values,
            args=self,
        )
        is_all = self.what == "all"
        reproduction.check_sizes(reproduction.REPORTED if is_all else [self.what], settings)
        if is_all:
            return reproduction.run_all(settings, output)
        return reproduction.run_one(self.what, settings, output)[0]

    def _check(self) -> None:
        for option, limit in {"trials": 1, "episodes": 1, "particles": 2}.items():
            if getattr(self, option) is not None:
                check_minimum(limit, **{f"--{option}": getattr(self, option)})
        for option, experiments in _EXPERIMENTS_OF_OPTION.items():
            if getattr(self, option) and self.what not in experiments:
                names = " and ".join(experiments)
                raise UsageError(f"--{option} is for {names}, but {self.what} is run")
        check_seed(self.seed or 0, "--seed")
        checks.check_folder("--out", self.out)
        if self.what in ("fig1", "fig3", "fig4", "all"):
            checks.check_extra(f"{self.what} draws pictures and needs", "matplotlib", "viz")
        policies = _ALLOWED_POLICIES.get(self.what, (self.policy,))
        if self.policy not in ("all", *policies):
            raise UsageError(
                f'--policy is "{self.policy}", but {self.what} takes {" or ".join(policies)}'
            )
        # Options that the experiment would ignore.
        sizes = ("episodes", "particles") if self.what == "table3" else ()
        unread = [name for name in sizes if getattr(self, name)]
        taken = _SETTING_GROUPS.get(self.what, self.SETTINGS)
        settings = read_options(self.settings, self.SETTINGS)
        unread += [".".join(path).replace("_", "-") for path in settings if path[0] not in taken]
        if unread:
            raise UsageError(f"--{unread[0]} changes nothing in {self.what}: leave it out")

    def command(self, what: str) -> str:
        """Build the command line that repeats an experiment."""
        parts = ["jaxlangnav reproduce", what]
        for name in ("episodes", "policy", "extra", "ranges", "seed", "particles"):
            if (value := getattr(self, name)) != getattr(type(self), name):
                parts += [f"--{name}"] if value is True else [f"--{name}", shlex.quote(str(value))]
        for path, value in read_options(self.settings, self.SETTINGS).items():
            flag = ".".join(path).replace("_", "-")
            numbers = value if isinstance(value, tuple) else (value,)
            parts.append(f"--{flag} {','.join(f'{number:g}' for number in numbers)}")
        return " ".join(parts)
