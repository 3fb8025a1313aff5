"""Why a source, a point or the store gives nothing: one table of codes, the same words in log, MQTT and /readyz."""

REASONS: dict[str, tuple[str, str]] = {
    # code: (what it means, what to do)
    "starting": ("no data since the service started", "wait some seconds; then check the source's address"),
    "refused": (
        "the connection was refused: nothing listens at this address",
        "check the address, and that the camera is on",
    ),
    "not_found": ("the stream or device does not exist", "check the path in the address"),
    "unauthorized": ("user and password were rejected", "correct them in the address, or in [mqtt]"),
    "no_answer": ("the device does not answer", "check cable, power and address"),
    "no_video": ("the stream contains no video", "check the camera's settings"),
    "damaged": (
        "the received data cannot be decoded",
        "check the camera's codec; watch the stream with another program",
    ),
    "stopped": ("the stream stopped delivering data", "check cable and power; midspan reconnects automatically"),
    "ended": ("the stream ended", "check the camera; midspan reconnects automatically"),
    "replay_ended": (
        "the replayed recording has ended",
        "start `midspan run` again to replay it, or use a longer one if the point gave no rows",
    ),
    "process_ended": ("the camera's process ended", "midspan restarts it automatically; see the log if it repeats"),
    "size_changed": ("the frame size changed", "restore the camera's settings, or calibrate again"),
    "silent": ("no data for some seconds", "check the sensor, its cable and its sender"),
    "payload": ("a message has an invalid format", "check the sender's version, kind and length"),
    "clock_ahead": ("time stamps are in the future", "synchronise the clocks of the sender and of this machine (NTP)"),
    "no_values": ("the received values are not numbers", "check the sensor and its logger"),
    "dark": ("the images are dark", "check the light, and whether something covers the camera"),
    "frozen": ("the same image or value repeats (frozen)", "check the camera or sensor, and its sender"),
    "broker_gone": (
        "the MQTT broker cannot be reached",
        "check the broker; midspan reconnects automatically",
    ),
    "untrusted": (
        "the certificate of the MQTT broker or of this site was rejected",
        "check [mqtt] ca, cert and key, and that host is a name in the broker's certificate",
    ),
    "name_taken": (
        "another service with this site's name is connected to the MQTT broker",
        "give each site a unique name, or stop the other service",
    ),
    "store_unavailable": ("the store cannot be written", "check disk or database; new data are buffered"),
    "store_full": ("the store's disk is full", "free disk space; new data are buffered"),
    "rows_dropped": ("the store was unavailable for too long, and rows were lost", "see the events for the time"),
    "results_dropped": (
        "the MQTT broker receives results too slowly, and the oldest were not published",
        "check the network and the broker's load; the rows are in the store",
    ),
    "capture_failed": (
        "the captured recording cannot be written",
        "free disk space, or set another folder (store.captures)",
    ),
    "calibrating": ("the point records data for its calibration", "wait; the structure must move meanwhile"),
    "calibration_refused": ("the calibration was refused", "see the event; midspan retries automatically"),
    "calibration_offered": (
        "a calibration awaits acceptance",
        'accept or refuse it in the page\'s Calibration (scripts: MQTT cmd/accept), or set accept = "auto"',
    ),
    "opening": ("the point is being opened", "wait some seconds"),
    "clock": (
        "the accelerometer's clock was set back; its data are ignored until the time stamps increase again",
        "wait some seconds; let NTP slew the clocks of sensors and machine",
    ),
    "no_rows": ("the point gives no rows although its sources deliver data", "see its events"),
    "paused": ("the source is paused", "resume it when it is available again"),
    "settings": ("SITE.toml is wrong", "correct the key that the message names; the previous settings stay in force"),
    "not_measuring": ("no measuring process is running", "start `midspan run`; stored data remain available"),
    "engine_silent": ("the measuring process does not answer", "wait; if it persists, check its log and the load"),
    "overflow": (
        "more readings arrive than can be filtered; the newest are lost",
        "lower the rates, or use more shards",
    ),
    "lost": ("the sensor's target is lost", "check the image for an obstruction"),
}


# A command of a calibration on a point of a group.
NOT_CALIBRATED = (
    "is a point of a group, which has no calibration. Set the units and the noise of its sensors in [[group]], or make "
    "it a [[point]], which calibrates itself."
)


def sentence(code: str) -> str:
    """What a code means, as a sentence."""
    meaning, remedy = REASONS[code]
    return f"{meaning[0].upper()}{meaning[1:]}: {remedy}."
