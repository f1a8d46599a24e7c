"""No words end the comment that they stand in."""

from __future__ import annotations

import tokenize
import xml.etree.ElementTree as ET
from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.analysis.export.tunings import HOSTILE
from tunenet_logs.analysis.export.exported import hash_comment, xml_comment

WORDS = st.lists(st.text(st.characters() | st.sampled_from("-><!#\n\r\x85\u2028\"'")), max_size=4)


@given(WORDS)
def test_an_xml_comment_ends_where_it_should(lines: list[str]):
    text = f"<a>{xml_comment(lines)}<b/></a>"
    root = ET.fromstring(text.encode())
    assert [child.tag for child in root] == ["b"]
    assert not "".join(root.itertext())
    assert text.count("\n") == len(lines) + 1


@given(WORDS)
def test_a_hash_comment_is_nothing_but_comments(lines: list[str]):
    text = hash_comment(lines)
    kinds = {token.type for token in tokenize.generate_tokens(StringIO(text + "\n").readline)}
    assert kinds <= {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.ENDMARKER}
    assert len(text.splitlines()) == len(lines)


@pytest.mark.parametrize("make", [xml_comment, hash_comment])
def test_words_stay_readable(make):
    assert "plain words, é and -5" in make(["plain words, é and -5"])
    assert "remove" in make([HOSTILE])
