"""What a stream of utterances leaves behind: words joined, things ruled out, what is spoken of."""

from jaxlangnav.conversation.join import Joined, first_words, join
from jaxlangnav.conversation.memory import (
    AVOID_ALL,
    AVOID_IT,
    Conversation,
    Words,
    avoided,
    begin_conversation,
    excluding,
    focus,
    pinned,
    seen_from,
    without,
)

__all__ = [
    "AVOID_ALL",
    "AVOID_IT",
    "Conversation",
    "Joined",
    "Words",
    "avoided",
    "begin_conversation",
    "excluding",
    "first_words",
    "focus",
    "join",
    "pinned",
    "seen_from",
    "without",
]
