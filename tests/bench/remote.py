"""Measure the bytes that a bucket sends for a batch, against those of its logs.

`python -m tests.bench.remote` puts logs of `tests.bench.state_logs` into a real S3 server on this
machine (moto), behind a relay that counts what the server sends: listing, headers and contents.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.analysis.batch.relay import CountingRelay
from tests.bench.state_logs import write_log

MAX_RATIO = 1.1


def figures(count: int = 100) -> dict[str, Any]:
    """Measure bytes sent for tuning `count` logs once, and with `--resume`, over the logs' own."""
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    relay = CountingRelay(server.get_host_and_port()[1])
    os.environ |= {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{relay.port}",
    }
    client = boto3.client("s3")
    client.create_bucket(Bucket="lab")
    size = 0
    with tempfile.TemporaryDirectory() as folder:
        for index in range(count):
            log = Path(folder) / f"{index:05}.mcap"
            write_log(log, index)
            size += log.stat().st_size
            client.upload_file(str(log), "lab", f"runs/{log.name}")
        words = [
            sys.executable,
            "-m",
            "tunenet_logs.analysis.cli.tune",
            "s3://lab/runs/",
            "--quiet",
        ]
        words += ["-o", f"{folder}/out", "--no-review", "--resume", "--jobs", "2"]
        sent = []
        for _ in range(2):
            relay.passed = 0
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
            sent.append(relay.passed)
    server.stop()
    first, again = (one / size for one in sent)
    print(f"{count} logs of {size / count / 1e3:.1f} kB: {sent[0]} bytes sent for {size}")
    print(f"{first:.3f} times the logs (wanted: at most {MAX_RATIO}), {again:.3f} with --resume")
    return {"logs": count, "bytes": size, "times_read": round(first, 4), "again": round(again, 4)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    figures(parser.parse_args().count)


if __name__ == "__main__":
    main()
