"""Why a source, a point or the store gives nothing: one table of codes, the same words in log, MQTT and /readyz."""

REASONS: dict[str, tuple[str, str]] = {
    # code: (what it means, what to do)
    "starting": ("nothing came yet since the service began", "wait some seconds; then check the source's address"),
    "refused": ("the connection is refused: nothing listens there", "check the address and that the camera is on"),
    "not_found": ("there is no such stream or device", "check the path behind the address"),
    "unauthorized": ("user and password are not accepted", "correct them in the address, or in [mqtt]"),
    "no_answer": ("what is there does not answer", "check cable, power and address"),
    "no_video": ("the stream holds no video", "check the camera's settings"),
    "damaged": ("what comes cannot be read", "check the camera's codec; watch the stream with another program"),
    "stopped": ("a stream that ran brings nothing", "check cable and power; it is opened again automatically"),
    "ended": ("the stream ended", "check the camera; it is opened again automatically"),
    "replay_ended": (
        "the recording that is replayed has ended",
        "start `midspan run` again to replay it anew, or use a longer one where the point gave no rows",
    ),
    "process_ended": ("the camera's process ended", "it is started again automatically; see the log if it repeats"),
    "size_changed": ("frames have another size than before", "set the camera back, or calibrate again"),
    "silent": ("nothing has come for some seconds", "check the sensor, its cable and its sender"),
    "payload": ("a message is not as documented", "check the sender's version, kind and length"),
    "clock_ahead": ("stamps are of the future", "set the clocks of the sender and of this machine (NTP)"),
    "no_values": ("the values that come are no numbers", "check the sensor and its logger"),
    "dark": ("the pictures are dark", "check the light and what stands in front of the camera"),
    "frozen": ("the same picture or value comes again and again", "check the camera or sensor, and what sends for it"),
    "broker_gone": (
        "the MQTT broker cannot be reached",
        "check the broker; it is connected again automatically",
    ),
    "untrusted": (
        "the MQTT broker's certificate is not accepted, or it does not accept this site's",
        "check [mqtt] ca, cert and key, and that host is a name in the broker's certificate",
    ),
    "name_taken": (
        "another service with this site's name is connected to the MQTT broker",
        "give each site a name of its own, or stop the other service",
    ),
    "store_unavailable": ("the store cannot be written", "check disk or database; what comes meanwhile is held back"),
    "store_full": ("the store's disk is full", "make room; what comes meanwhile is held back"),
    "rows_dropped": ("the store was away for too long, and rows were lost", "see the events for when"),
    "capture_failed": (
        "the captured recording cannot be written",
        "make room, or name another folder (store.captures)",
    ),
    "calibrating": ("the point records what it is calibrated on", "wait; the structure has to move meanwhile"),
    "calibration_refused": ("the calibration could not be trusted", "see the event; it is tried again automatically"),
    "calibration_offered": (
        "a calibration waits to be accepted",
        'accept or refuse it in the page\'s Calibration (scripts: MQTT cmd/accept), or set accept = "auto"',
    ),
    "opening": ("the point is being opened", "wait some seconds"),
    "clock": (
        "the accelerometer's clock was set, and its stamps are left out until they go on",
        "wait some seconds; let NTP slew the clocks of sensors and machine",
    ),
    "no_rows": ("the point gives no rows though its sources bring records", "see its events"),
    "paused": ("the source is left out on purpose", "resume it once it is there again"),
    "settings": ("SITE.toml is wrong", "correct what the message names; what was in force before holds meanwhile"),
    "not_measuring": ("no process measures here", "start `midspan run`; what is stored can be looked at meanwhile"),
    "engine_silent": ("the measuring process does not answer", "wait; where it lasts, see its log and the load"),
    "lost": ("the sensor's target is lost", "see the image; something may stand in front of it"),
}


def sentence(code: str) -> str:
    """What a code means, as a sentence."""
    meaning, remedy = REASONS[code]
    return f"{meaning[0].upper()}{meaning[1:]}: {remedy}."
