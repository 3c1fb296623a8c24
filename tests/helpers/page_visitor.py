"""A visitor of the page who is no browser: raw messages over a raw WebSocket."""

import time
from urllib.parse import urlsplit

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

__all__ = ["SUBPROTOCOL", "ConnectionClosed", "Visitor"]

SUBPROTOCOL = f"viser-v{viser.__version__}"
LOOK = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [1.5, 0, 0],
    "fov": 0.75,
    "near": 0.01,
    "far": 1000,
    "image_height": 640,
    "image_width": 1200,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
"""What a browser sends first."""


class Visitor:
    """What a browser does, without one: a WebSocket whose messages are read and written raw."""

    def __init__(self, address, name=""):
        """Visitors with a name are known again by it."""
        url = urlsplit(address)
        path = f"{url.path.rstrip('/')}/{name}".rstrip("/")
        self.socket = connect(
            f"ws://{url.netloc}{path}",
            origin=f"http://{url.netloc}",
            subprotocols=[SUBPROTOCOL],
            compression=None,
            max_size=None,
            max_queue=None,
        )
        self.controls = {}
        self.texts = {}
        self.camera_m = None
        self.reset_camera_m = None
        self.acknowledged = 0
        self.send(LOOK)

    def send(self, message):
        self.socket.send(msgspec.msgpack.encode(message))

    def look_from(self, *position_m, **changed):
        """The browser's camera is elsewhere."""
        self.camera_m = None
        self.send({**LOOK, "position": position_m, **changed})

    def put(self, label, value):
        uuid = self.controls[label]
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def read(self, seconds=0.05):
        """Takes what comes within a time: controls by label, texts by uuid."""
        until = time.monotonic() + seconds
        try:
            while True:
                raw = self.socket.recv(timeout=until - time.monotonic())
                packed = raw[16 : 16 + int.from_bytes(raw[8:16], "little")]
                for message in msgspec.msgpack.decode(zstandard.decompress(packed))["messages"]:
                    self._take(message)
        except TimeoutError:
            return self

    def _take(self, message):
        new = message.get("props", message.get("updates", {}))
        if "content" in new:
            self.texts[message["uuid"]] = new["content"]
        if message["type"] == "SetCameraPositionMessage":
            if message["initial"]:
                self.reset_camera_m = message["position"]
            else:
                self.camera_m = message["position"]
        if message["type"].startswith("Gui") and "label" in message.get("props", {}):
            self.controls[new["label"]] = message["uuid"]
        self.acknowledged += message["type"] == "FileTransferPartAck"

    def reads(self, text):
        return any(text in shown for shown in self.read().texts.values())

    def close(self):
        self.socket.close()
