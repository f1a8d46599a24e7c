"""Video that becomes JPEGs beside the thread that reads it; what is too much is counted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import av

from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.mjpeg_camera import number_in
from tests.recorders.test_packet_stream import FRAMES, H264_MP4, opened, recorded
from tunenet_logs.episode import Frame
from tunenet_logs.recorders.camera import reading as transcoded
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.streams import PacketStream
from tunenet_logs.recorders.local_page import PreviewVideo


class Held(PacketStream):
    """Falls silent after some pictures until it is let go."""

    def __init__(self, path: Path, shown: int) -> None:
        super().__init__(av.open(str(path)), path.name, LAST_RESORT_S)
        self.go_on = threading.Event()
        self._shown = shown

    def decoder(self) -> av.VideoCodecContext:
        one = super().decoder()
        one.thread_count = 1  # each more would hold back a picture
        return one

    def frames(self) -> Iterator[CapturedFrame]:
        for number, shot in enumerate(super().frames()):
            if number == self._shown:
                self.go_on.wait(LAST_RESORT_S)
            yield shot


def test_what_does_not_fit_is_dropped_up_to_the_next_key_frame_and_counted(
    tmp_path: Path, monkeypatch
):
    path = H264_MP4.write(tmp_path)
    sizes = [len(shot.frame.data) for shot in opened(path).frames()]
    monkeypatch.setattr(transcoded, "_MAX_WAITING_BYTES", sum(sizes[1:15]))
    source = Held(path, 1)
    made = Transcoded(source)
    shots = made.frames()
    seen = [next(shots)]  # held by whoever looks at it, while all others come
    source.go_on.set()
    wait_until(lambda: made._reader.queue.captured == FRAMES, "all packets come")
    seen += list(shots)
    numbers = [number_in(shot.frame.decode()) for shot in seen]
    assert numbers == list(range(len(numbers)))
    assert 10 < len(numbers) <= 20
    assert made.dropped == FRAMES - len(numbers)
    assert made.damaged == 0


def test_what_still_waits_at_the_end_is_counted(tmp_path: Path):
    made = Transcoded(opened(H264_MP4.write(tmp_path)))
    shots = made.frames()
    next(shots)
    wait_until(lambda: made._reader.queue.captured == FRAMES, "all packets come")
    shots.close()  # type: ignore[attr-defined]
    assert made.dropped == FRAMES


def test_a_decoder_s_word_on_damage_is_counted(tmp_path: Path):
    path = H264_MP4.write(tmp_path)

    class Damaged(PacketStream):
        def frames(self) -> Iterator[CapturedFrame]:
            for number, shot in enumerate(super().frames()):
                broken = Frame(shot.frame.stamp_ns, "h264", b"\0\0\1\x65" + b"\xa5" * 50)
                yield shot._replace(frame=broken) if number == 30 else shot

    source = Transcoded(Damaged(av.open(str(path)), "a", LAST_RESORT_S))
    summary, episode = recorded(source, tmp_path / "a.mcap")
    assert summary.damaged > 0
    assert summary.written + summary.damaged + summary.dropped == FRAMES
    assert episode.info.counts["written"] == summary.written


def test_a_viewer_sees_a_few_pictures_of_a_video(tmp_path: Path):
    shots = list(opened(H264_MP4.write(tmp_path)).frames())
    shown: list[Frame] = []
    video = PreviewVideo(shown.append)
    video.start()
    try:
        for shot in shots:
            video.offer(shot.frame)
        wait_until(lambda: bool(shown), "a picture")
        assert shown[0].encoding == "jpeg"
        assert number_in(shown[0].decode()) == 0
        video.skip()  # nobody looked for a while
        count = len(shown)
        for shot in shots[25:30]:
            video.offer(shot.frame)

        def is_shown_another() -> bool:
            for shot in shots[30:]:
                video.offer(shot.frame)
            return len(shown) > count

        wait_until(is_shown_another, "a picture after a pause")
        assert number_in(shown[-1].decode()) >= 30  # from the next key frame on
    finally:
        video.close()
        video.join(LAST_RESORT_S)
    assert not video.is_alive()
