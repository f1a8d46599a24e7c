"""HLS over real sockets: whole, live and hostile playlists, of one host alone."""

from __future__ import annotations

import time
from itertools import count

import numpy as np
import pytest

from recorders.camera.playlist import read_playlist
from recorders.camera.sources import open_source
from tests.recorders.byte_servers import Answer, serving
from tests.recorders.films import RATE_HZ, film
from tests.recorders.hostile_cameras import sending
from tests.recorders.live_wait import LAST_RESORT_S
from tunenet_logs.errors import CameraError

pytestmark = pytest.mark.live

HEAD = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n"
END = "#EXT-X-ENDLIST\n"
TS = film("mpegts")


def answers(**texts: str) -> dict[str, Answer]:
    """Playlists by their names, beside a film at /a.ts."""
    lists = {f"/{name}.m3u8": Answer(text.encode()) for name, text in texts.items()}
    return {**lists, "/a.ts": Answer(TS)}


def recorded(text: str, **others: str) -> tuple[int, bool]:
    """How many pictures a playlist leads to, and whether it is live."""
    with serving(answers(list=text, **others)) as place:
        source = open_source(f"{place}/list.m3u8", timeout_s=LAST_RESORT_S)
        return len(list(source.frames())), source.live


def test_all_pieces_one_after_the_other():
    assert recorded(f"{HEAD}#EXTINF:1,\na.ts\n#EXT-X-DISCONTINUITY\n#EXTINF:1,\n/a.ts\n{END}") == (
        60, False,
    )  # fmt: skip


def test_the_best_variant_that_the_host_has():
    variants = "#EXTM3U\n" + "".join(
        f"#EXT-X-STREAM-INF:BANDWIDTH={bits}\n{url}\n"
        for bits, url in ((100, "low.m3u8"), (300, "high.m3u8"), (900, "http://10.0.0.9/best.m3u8"))
    )
    high = f"{HEAD}a.ts\na.ts\n{END}"
    assert recorded(variants, low=f"{HEAD}a.ts\n{END}", high=high)[0] == 60


def test_the_start_of_an_mp4_stands_before_its_pieces():
    whole = film("mp4", movflags="frag_keyframe+empty_moov")
    at = whole.index(b"moof") - 4
    text = f'{HEAD}#EXT-X-MAP:URI="start"\nrest\n{END}'
    pieces = {"/start": Answer(whole[:at]), "/rest": Answer(whole[at:])}
    with serving({"/list": Answer(text.encode()), **pieces}) as place:
        source = open_source(f"{place}/list", timeout_s=LAST_RESORT_S)
        stamps_ns = [shot.frame.stamp_ns for shot in source.frames()]
    assert np.allclose(np.diff(stamps_ns), 1e9 / RATE_HZ, atol=1e6)
    assert len(stamps_ns) == 30


def test_a_live_list_begins_with_its_newest_piece_and_is_asked_again():
    asked = count()

    def text() -> bytes:
        number = next(asked)
        end = END if number > 2 else ""
        return (
            f"#EXTM3U\n#EXT-X-TARGETDURATION:0.2\n#EXT-X-MEDIA-SEQUENCE:{7 + number}\n"
            f"gone.ts\na.ts\n{end}"
        ).encode()

    with serving({"/x": Answer(text), "/a.ts": Answer(TS)}) as place:
        source = open_source(f"{place}/x", timeout_s=LAST_RESORT_S)
        assert source.live
        assert len(list(source.frames())) == 4 * 30


def test_places_count_from_where_a_redirection_led():
    lists = {
        "/x": Answer(moved_to="/far/list"),
        "/far/list": Answer(f"{HEAD}a\n{END}".encode()),
        "/far/a": Answer(TS),
    }
    with serving(lists) as place:
        source = open_source(f"{place}/x", timeout_s=LAST_RESORT_S)
        assert len(list(source.frames())) == 30


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{HEAD}file:///etc/passwd\n{END}", "sends on to file://"),
        (f"{HEAD}http://10.0.0.9/a.ts\n{END}", "sends on to http://10.0.0.9"),
        (f"{HEAD}data:video/mp2t;base64,AAAA\n{END}", "sends on to data:"),
        (f"{HEAD}concat:/etc/passwd\n{END}", "sends on to concat:"),
        (f'{HEAD}#EXT-X-MAP:URI="file:///etc/passwd"\na.ts\n{END}', "sends on to file://"),
        (
            "#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1\nhttp://10.0.0.9/a.m3u8\n",
            "has its video on 10.0.0.9; if that is right, give that address",
        ),
        ("#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1\nlist.m3u8\n", "playlists of playlists"),
        (f"{HEAD}list.m3u8\n{END}", "is a playlist"),
        (f'{HEAD}#EXT-X-KEY:METHOD=AES-128,URI="k"\na.ts\n', r"encrypts its pieces \(EXT-X-KEY\)"),
        (f"{HEAD}#EXT-X-BYTERANGE:10@0\na.ts\n", "keeps its pieces in one file"),
        (HEAD + "a.ts\n" * 30_000, "names over 20000 pieces"),
        (HEAD + "a.ts\n" * 1_000_000, "sends a playlist of over 1 MiB"),
        (f"{HEAD}none.ts\n{END}", "answers 404"),
        (f"{HEAD}{END}", "ends before it sends anything"),
    ],
)
def test_a_hostile_list_is_told_in_one_line(text: str, says: str):
    with pytest.raises(
        CameraError, match=rf"^http://127.0.0.1:\d+/list.m3u8: [^\n]*{says}"
    ) as seen:
        recorded(text)
    assert str(seen.value).count("http://127.0.0.1") == 1


def test_a_list_without_an_end():
    with (
        sending(b"HTTP/1.0 200 OK\r\n\r\n" + HEAD.encode(), b"a.ts\n" * 1000) as url,
        pytest.raises(CameraError, match="over 1 MiB"),
    ):
        open_source(url, timeout_s=LAST_RESORT_S)


def test_a_live_list_that_stays_as_it_is_ends_by_the_stall():
    with serving(answers(list=f"{HEAD}a.ts\n")) as place:
        source = open_source(f"{place}/list.m3u8", timeout_s=2.0)
        before = time.monotonic()
        assert len(list(source.frames())) == 30
        assert time.monotonic() - before >= 2.0
        assert source.ended in ("no data for 2.0 s", "no whole picture for 2.0 s")


def test_pieces_longer_than_the_stall_are_told_beforehand():
    text = "#EXTM3U\n#EXT-X-TARGETDURATION:10\na.ts\n"
    with (
        serving(answers(list=text)) as place,
        pytest.raises(CameraError, match=r"sends pieces of 10 s, .*add --stall 30"),
    ):
        open_source(f"{place}/list.m3u8", timeout_s=5.0)


def test_a_long_list_is_read_in_no_time():
    data = (HEAD + "a\n" * 20_000).encode()
    before = time.process_time()
    assert len(read_playlist(data, "http://c/list").pieces) == 20_000
    assert time.process_time() - before < 5
