"""Write jaxlangnav/language/data/not_errors.txt: English words that look like typing errors.

A word of the list is never repaired: "beach" stays "beach", it is no mistyped "bench". Run it
after new words came into lexicon.toml; it needs ``pip install pyspellchecker`` (a list of English
words with their frequencies, MIT licence), which the package itself does not. A few vulgar words
are then taken out by hand.
"""

from pathlib import Path

from spellchecker import SpellChecker  # pyright: ignore[reportMissingImports]

import jaxlangnav.language
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.spelling import MIN_LETTERS, edits, repairable

MIN_COUNT = 400  # rarer "words" of the list are mostly typing errors themselves
HEAD = "# English words within one edit of a word of the lexicon; scripts/find_not_errors.py.\n"


def main() -> None:
    """Write the list beside the lexicon."""
    english = SpellChecker().word_frequency.dictionary
    vocabulary = load_lexicon().vocabulary
    words = {
        word
        for word, count in english.items()
        if len(word) >= MIN_LETTERS and count >= MIN_COUNT and word.isascii() and word.isalpha()
        and word not in vocabulary and edits(word) & repairable()
    }  # fmt: skip
    path = Path(jaxlangnav.language.__file__).parent / "data" / "not_errors.txt"
    path.write_text(HEAD + "\n".join(sorted(words)) + "\n", encoding="utf-8")
    print(f"{len(words)} words written to {path.name}")


if __name__ == "__main__":
    main()
