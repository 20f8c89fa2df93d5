"""What a stream of utterances leaves behind: words joined, things ruled out, what is spoken of."""

from jaxlangnav.dialogue.history import Merged as Merged, first_words as first_words
from jaxlangnav.dialogue.memory import (
    AVOID_ALL as AVOID_ALL,
    AVOID_IT as AVOID_IT,
    Conversation as Conversation,
    Words as Words,
    as_answered as as_answered,
    avoided as avoided,
    begin_conversation as begin_conversation,
    excluding as excluding,
    focus as focus,
    pinned as pinned,
    seen_from as seen_from,
)
from jaxlangnav.dialogue.merge import join as join
