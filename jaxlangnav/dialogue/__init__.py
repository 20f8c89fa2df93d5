"""Dialogue state: merged readings of all utterances, answers, exclusions and avoidance."""

from jaxlangnav.dialogue.history import Merged as Merged, discourse_of as discourse_of
from jaxlangnav.dialogue.memory import (
    Conversation as Conversation,
    DiscourseInfo as DiscourseInfo,
    add_avoidance as add_avoidance,
    apply_answers as apply_answers,
    begin_conversation as begin_conversation,
    compose_poses as compose_poses,
    exclude_slots as exclude_slots,
    forget_slots as forget_slots,
    new_task_fields as new_task_fields,
    pin_goals as pin_goals,
    task_mentions as task_mentions,
)
from jaxlangnav.dialogue.merge import merge_utterance as merge_utterance
