"""The story of an episode: every number in it is one of the recording's."""

import dataclasses
import math

import numpy as np
import pytest
import readings as by_hand
from recording_fixture import make_recording, make_scene

from jaxlangnav.episode.recording import Recording, Snapshot, StepView, stack_frames
from jaxlangnav.grounding.command_summary import CommandSummary
from jaxlangnav.messages import AT, BEHIND, BETWEEN, LEFT, NEAR, NONE, REGIONS, ROBOT, Fault, Status
from jaxlangnav.pytree import replace
from jaxlangnav.viz import html, narrative, sentences, summary
from jaxlangnav.viz.panels import outcome, verdict
from jaxlangnav.viz.sentences import FAULT_WORDS
from jaxlangnav.world.state import CONE, HYDRANT


@pytest.fixture(scope="module")
def one():
    return make_recording(9, 20)


@pytest.mark.parametrize(
    ("degrees", "said"),
    [
        (0, "ahead"),
        (44, "ahead to the left"),
        (90, "to the left"),
        (-90, "to the right"),
        (180, "behind"),
        (-180, "behind"),
        (270, "to the right"),
        (-44, "ahead to the right"),
        (-22, "ahead"),
    ],
)
def test_whereabouts_are_seen_from_the_robot(degrees, said):
    # The robot at (1, 1) heads up.
    bearing = math.radians(degrees + 90)
    x, y = 1.0 + 2.0 * math.cos(bearing), 1.0 + 2.0 * math.sin(bearing)
    assert sentences.describe_offset(x, y, 1.0, 1.0, math.pi / 2) == f"2.0 m {said}"
    assert sentences.describe_offset(1.1, 1.0, 1.0, 1.0, 0.0) == "right here"


def test_percent_never_rounds_to_certainty():
    said = [sentences.percent(share) for share in (0.0, 0.004, 0.37, 0.995, 1.0)]
    assert said == ["0 %", "< 1 %", "37 %", "> 99 %", "100 %"]


def readings_of(types, edges, superlative=False):
    told, sizes = [(*edge, superlative) for edge in edges], (1, len(types), len(edges))
    return by_hand.readings([types], [told], sizes=sizes)


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        (readings_of([HYDRANT, CONE], [(0, BEHIND, 1)]), "a hydrant behind a cone"),
        (readings_of([HYDRANT, CONE], [(0, NEAR, 1)], True), "a hydrant nearest to a cone"),
        (readings_of([HYDRANT, NONE], [(0, NONE, NONE)]), "a hydrant"),
        (readings_of([HYDRANT, ROBOT], [(0, LEFT, 1)]), "a hydrant to the left of the robot"),
        (
            readings_of([HYDRANT, CONE, 2], [(0, BEHIND, 1), (1, NEAR, 2)]),
            "a hydrant behind a cone near a car",
        ),
        (
            readings_of([HYDRANT, CONE, 2], [(0, BETWEEN, 1), (0, BETWEEN, 2)]),
            "a hydrant between a cone and a car",
        ),
        (readings_of([HYDRANT, CONE], [(0, NONE, NONE), (1, NONE, NONE)]), "a hydrant and a cone"),
        (readings_of([NONE, NONE], [(NONE, NONE, NONE)]), "nothing"),
        # A circle of relations must not be followed for ever.
        (readings_of([HYDRANT, CONE], [(0, BEHIND, 1), (1, BEHIND, 0)]), "nothing"),
    ],
)
def test_readings_in_words(one, readings, said):
    scene = dataclasses.replace(one.scene, readings=readings)
    assert sentences.describe_reading(scene, 0) == said
    head = html.page_data(dataclasses.replace(one, scene=scene))["summary"].split(".")[0]
    assert (f"there is {said} (" in head) is (said != "nothing")


@pytest.mark.parametrize(
    ("nouns", "said"),
    [
        (["cone"], "a cone"),
        (["cone", "cone"], "two cones"),
        (["box", "hydrant", "box", "box"], "three boxes and a hydrant"),
        (["bench"] * 5, "5 benches"),
    ],
)
def test_things_are_counted(nouns, said):
    assert sentences.noun_list(nouns) == said


def test_what_is_asked_for_is_told_with_its_constraints():
    scene = dataclasses.replace(
        make_scene(),
        commands=(
            CommandSummary("navigate", "normal", AT, 0, 0.99, ((NEAR, 1, 0.9),)),
            CommandSummary("find", "carefully", AT, 1, 0.7, ()),
            CommandSummary("navigate", "quickly", BEHIND, 1, 1.0, (), (), 0.5),
            CommandSummary("navigate", "normal", AT, NONE, 1.0, ()),
        ),
    )
    assert sentences.describe_commands(scene) == [
        "go to the hydrant behind a cone, keeping away from the cone",
        "find the cone carefully (70 %)",
        "go 0.5 m behind the cone quickly",
        "go to another one than before",
    ]
    assert "keeping away from the cone; then to find" in " ".join(narrative.opening(scene))


def test_what_cannot_be_judged_is_not_called_a_failure():
    recording = make_recording(3, 5)
    scene = dataclasses.replace(recording.scene, is_scored=False)
    unjudged = dataclasses.replace(recording, scene=scene)
    told = " ".join(narrative.closing(scene, unjudged.at(-1), unjudged.result))
    assert "Cannot be judged" in told
    assert "map known" not in told
    assert "known, the way to the goal itself is 9.1 m." in " ".join(narrative.narrate(recording))
    assert outcome(unjudged) == "cannot be judged"


def test_the_unseen_goal_has_a_share_only_where_there_is_doubt(one):
    frame = replace(
        one.at(0),
        goal_mass=np.zeros_like(one.at(0).goal_mass),
        hypothesis_goal_mass=one.at(0).weight,
    )
    assert "has not been seen yet: " in sentences.describe_goal(one.scene, frame)
    doubtful = replace(frame, hypothesis_goal_mass=0.9 * frame.weight)
    assert "has not been seen yet (90 %): " in sentences.describe_goal(one.scene, doubtful)


def test_every_step_is_in_the_story_once():
    told = narrative.narrate(make_recording(12, 20))
    heads = [line[1:].split("·")[0].strip() for line in told if line.startswith("[")]
    covered = []
    for head in heads:
        first, _, last = head.partition("-")
        covered += range(int(first), int(last or first) + 1)
    assert covered == list(range(12))


def test_the_closing_tells_failures_apart():
    one = make_recording(4, 10)
    frame, scene = one.at(-1), one.scene
    timeout = replace(one.result, is_stopped=np.array(False), is_success=np.array(False))
    assert "ran out of time" in narrative.closing(scene, frame, timeout)[0]
    wrong = replace(one.result, is_success=np.array(False), goal_distance=np.float32(6.2))
    assert "6.2 m away" in narrative.closing(scene, frame, wrong)[0]
    counts = {"overflow": 3, "degenerate": 2, "contradictions": 4, "faults": 5}
    crowded = replace(one.result, **{name: np.int32(n) for name, n in counts.items()})
    said = " ".join(narrative.closing(scene, frame, crowded))
    assert "3 detections" in said
    assert "In 2 steps" in said
    assert "In 4 steps it saw what contradicts its map" in said
    assert "In 5 steps it stood still, for what cannot be was reported to it." in said


def moment(one: Recording, frame: Snapshot, before: Snapshot | None) -> StepView:
    return StepView(3, one.scene, frame, before, (), one.result)


def test_what_is_passed_and_not_spoken_of_is_told_once():
    one = make_recording(6, 10)
    tree = {"object_type": np.array([4, NONE]), "x": np.array([2.0, 0]), "y": np.array([1.0, 0])}
    passed = replace(one.at(1).bystanders, **tree)
    frames = [one.at(0), *(replace(one.at(step), bystanders=passed) for step in range(1, 6))]
    steps, live = [(it, one.result) for it in frames], list[str]()
    list(narrative.narrate_live(one.scene, steps, [], live.extend))
    for told in (narrative.narrate(stack_frames(one.scene, steps)), live):
        assert sum("a tree" in line for line in told) == 1
    # What words come to mention moves to another slot, and is not discovered again.
    other = {name: values[::-1] for name, values in tree.items()}
    moved = replace(one.at(1), bystanders=replace(passed, **other))
    assert [obj.object_type for obj in summary.observed_objects(moved)][-1] == 4
    assert not sentences.new_objects(moment(one, moved, frames[1]))


def test_an_ending_without_a_goal_is_told_and_named():
    one = make_recording(4, 10)
    ended = replace(
        one.at(-1),
        object_type=np.full_like(one.frames.object_type[-1], NONE),
        status=np.int32(Status.NOT_FOUND),
        is_stop=np.array(False),
    )
    told = narrative.narrate_step(moment(one, ended, one.at(2)))[-1]
    assert told.startswith("Says that there is no hydrant and no cone: ")
    assert narrative.headline(moment(one, ended, one.at(2))) == "gives up"
    assert not narrative._is_uneventful(moment(one, ended, one.at(2)))
    result = replace(one.result, ending=np.int32(Status.NOT_FOUND), is_success=np.array(False))
    closing = narrative.closing(one.scene, ended, result)
    assert closing[0] == "Not found: it says that there is no hydrant and no cone."
    assert verdict(dataclasses.replace(one, result=result)).startswith("faithful policy: not found")


def test_a_landmark_that_was_not_found_is_told():
    one = make_recording(4, 10)
    frame = one.at(-1)
    assert frame.object_type[0, 0] == CONE
    blind = replace(frame, object_type=np.where(frame.object_type == CONE, NONE, frame.object_type))
    assert "no cone was to be found" in narrative.narrate_step(moment(one, blind, one.at(2)))[-1]
    assert narrative.closing(one.scene, blind, one.result)[-1] == (
        "It has seen no cone, and took what fits best."
    )
    assert "no cone" not in " ".join(narrative.closing(one.scene, frame, one.result))


@pytest.mark.parametrize("fault", Fault)
def test_a_step_with_a_fault_says_why_it_stands(one, fault: Fault):
    frame = replace(one.at(3), fault=np.int32(fault))
    (told,) = narrative.narrate_step(moment(one, frame, one.at(2)))
    assert told == f"Stands still: {FAULT_WORDS[fault]}."
    both = replace(frame, fault=np.int32(Fault.POSE | Fault.SENSOR))
    (told,) = narrative.narrate_step(moment(one, both, None))
    assert told.count(FAULT_WORDS[Fault.POSE]) == told.count(FAULT_WORDS[Fault.SENSOR]) == 1
    assert narrative.headline(moment(one, frame, one.at(2))) == "stands still"
    assert not narrative._is_uneventful(moment(one, frame, one.at(2)))


def test_a_long_search_is_told_ten_steps_a_line(one):
    for number, said in (1, "1 hypothesis"), (2, "2 hypotheses"), (600, "hypotheses refuted 600 t"):
        frame = replace(one.at(1), num_regrounded=np.int32(number), waypoint_kind=np.int32(0))
        _, second = narrative._merge_steps([moment(one, frame, one.at(0))] * 11, one)
        assert said in second


def test_headlines_say_what_happened(one):
    heads = [narrative.headline(moment) for moment in one.steps]
    assert heads[:2] == ["hears the sentence, sees nothing", "not there: 25 % refuted"]
    assert heads[4:9:2] == ["discovers a cone", "discovers a hydrant", "says stop"]


def test_a_region_goal_is_named_as_a_place(one):
    frame = one.at(7)
    region = np.full(frame.goal_region.shape, REGIONS.index("behind"), np.int32)
    assert sentences._goal_name(one.scene, frame, 1) == "the hydrant"
    frame = replace(frame, goal_region=region)
    assert sentences._goal_name(one.scene, frame, 1) == "the place behind the hydrant"
    # Without goal probability a region says nothing: the object itself is meant.
    assert sentences._goal_name(one.scene, frame, 0) == "the cone"


def test_the_next_command_is_told():
    one = make_recording(6, 20)
    before, frame = one.at(1), replace(one.at(2), clause=np.int32(1))
    assert narrative.headline(moment(one, frame, before)) == "turns to the next command"
    assert narrative.narrate_step(moment(one, frame, before))[0].startswith(
        "Turns to command 2 of "
    )
    assert not narrative._is_uneventful(moment(one, frame, before))


def test_a_changed_reading_is_told():
    one = make_recording(4, 20)
    before, frame = one.at(1), replace(one.at(2), reading=np.ones(20, np.int32))
    assert "a hydrant (" in sentences.describe_new_reading(moment(one, frame, before))
    assert sentences.describe_new_reading(moment(one, before, before)) == ""


def test_objects_are_summed_up_over_particles(one):
    assert summary.observed_objects(one.at(0)) == []
    cone, hydrant = summary.observed_objects(one.at(-1))
    assert (cone.object_type, hydrant.object_type) == (CONE, HYDRANT)
    assert (hydrant.x, hydrant.y) == pytest.approx((9.0, 1.0), abs=1e-5)
    assert hydrant.probability == pytest.approx(1.0, abs=1e-5)
    assert hydrant.goal_mass == pytest.approx(0.9)


def test_the_expected_goal_by_hand(one):
    frame = one.at(0)
    want = (frame.weight * frame.hypothesis_goal_x).sum() / frame.weight.sum()
    assert summary.expected_goal(frame)[0] == pytest.approx(want, abs=1e-4)
    # At the end the only goal is the hydrant; over all steps the same numbers come out.
    assert summary.expected_goal(one.at(-1)) == pytest.approx((9.0, 1.0))
    assert summary.expected_goal(one.frames)[0] == pytest.approx(summary.expected_goal(frame))


def test_peaks_find_two_clusters(one):
    x = np.where(np.arange(20) < 12, 2.0, 10.0).astype(np.float32)
    mass = np.full(20, 0.05, np.float32)
    y = np.zeros(20, np.float32)
    frame = replace(one.at(0), hypothesis_goal_x=x, hypothesis_goal_y=y, hypothesis_goal_mass=mass)
    first, second = summary.goal_modes(frame)
    assert first == pytest.approx((2.0, 0.0, 0.6), abs=1e-5)
    assert second == pytest.approx((10.0, 0.0, 0.4), abs=1e-5)
    nothing = replace(frame, hypothesis_goal_mass=0 * mass)
    assert summary.goal_modes(nothing) == []
    assert np.isnan(summary.expected_goal(nothing)).all()


def test_the_goal_field_is_the_sum_of_equation_11(one):
    frame, gamma = one.at(-1), float(one.scene.planner.discount)
    here = summary.goal_field(one.scene, frame, np.array([9.0, 4.0]), np.array([1.0, 1.0]))
    assert here == pytest.approx([0.9, 0.9 * gamma**5], rel=1e-4)


@pytest.mark.parametrize("number", [1, 2, 4, 6, 50])
def test_moments_hold_first_and_last(number):
    chosen = narrative.select_steps(make_recording(12, 10), number)
    assert len(chosen) == min(number, 12)
    assert chosen == sorted(set(chosen))
    assert chosen[-1] == 11
    assert number == 1 or chosen[0] == 0


def test_moments_catch_the_discoveries():
    one = make_recording(13, 10)
    news = np.flatnonzero(one.frames.is_news)
    assert set(news) <= set(narrative.select_steps(one, 6))
    with pytest.raises(ValueError, match="number of panels is 0"):
        narrative.select_steps(make_recording(3, 5), 0)
