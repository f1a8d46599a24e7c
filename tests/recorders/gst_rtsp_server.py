"""GStreamer's RTSP server, run by the system's Python, which alone knows GStreamer.

It prints the port on which it listens and serves /stream until it is killed. SIGUSR1 cuts every
connection.
"""

from __future__ import annotations

import argparse
import signal
from pathlib import Path
from typing import Any

import gi  # type: ignore[import-not-found]

for library in ("Gst", "GstRtsp", "GstRtspServer"):
    gi.require_version(library, "1.0")
from gi.repository import (  # type: ignore[import-not-found]  # noqa: E402
    Gio,
    GLib,
    Gst,
    GstRtsp,
    GstRtspServer,
)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("launch", help="a pipeline whose payloader is called pay0")
    parser.add_argument("--transports", default="tcp,udp", help="what SETUP may ask for")
    parser.add_argument("--auth", choices=("basic", "digest"))
    parser.add_argument("--tls", type=Path, help="a certificate and its key in one PEM file")
    parser.add_argument("--port", default="0")
    arguments = parser.parse_args()

    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(arguments.port)
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch(arguments.launch)
    protocols = GstRtsp.RTSPLowerTrans(0)
    for name in arguments.transports.split(","):
        protocols |= getattr(GstRtsp.RTSPLowerTrans, name.upper())
    factory.set_protocols(protocols)
    server.set_auth(access(arguments, factory))
    server.get_mount_points().add_factory("/stream", factory)
    server.attach(None)
    GLib.unix_signal_add(GLib.PRIORITY_HIGH, signal.SIGUSR1, cut, server)
    print(server.get_bound_port(), flush=True)
    GLib.MainLoop().run()


def cut(server: Any) -> bool:
    """Hang up on everybody; the next are answered."""
    server.client_filter(lambda *_words: GstRtspServer.RTSPFilterResult.REMOVE)
    return True


def access(arguments: argparse.Namespace, factory: Any) -> object:
    """Who may look, and by which certificate."""
    if not arguments.auth and not arguments.tls:
        return None
    auth = GstRtspServer.RTSPAuth()
    if arguments.tls:
        auth.set_tls_certificate(Gio.TlsCertificate.new_from_file(str(arguments.tls)))
    token = GstRtspServer.RTSPToken()
    token.set_string("media.factory.role", "user")
    permissions = GstRtspServer.RTSPPermissions()
    for permission in ("media.factory.access", "media.factory.construct"):
        permissions.add_permission_for_role("user", permission, True)
    factory.set_permissions(permissions)
    if arguments.auth == "digest":
        auth.set_supported_methods(GstRtsp.RTSPAuthMethod.DIGEST)
        auth.add_digest("me", "secret", token)
    elif arguments.auth == "basic":
        known = GstRtspServer.RTSPAuth.make_basic("me", "secret")
        auth.add_basic(known, token)
    else:
        auth.set_default_token(token)
    return auth


if __name__ == "__main__":
    main()
