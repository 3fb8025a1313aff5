"""The trackers that follow from key frames: opened when they are needed; what they remember is in the key frames."""

from typing import Any

from midspan.records import Frame, PixelTranslation, Prediction, Region
from midspan.vision.reference.records import KeyFrame, contrast
from midspan.vision.tracker import Tracker, open_tracker


class InnerTrackers:
    """Trackers of one kind, one for each key frame."""

    def __init__(self, name: str, settings: Any) -> None:
        self._name, self._settings = name, settings
        self._open: list[tuple[Tracker, Any]] = []

    def key(self, frame: Frame, region: Region) -> KeyFrame:
        """A new key frame. Raises UsageError where too little texture is left for a reference."""
        tracker = open_tracker(self._name, frame, region, self._settings)
        self._open.append((tracker, tracker.state))
        return KeyFrame(frame, region, tracker.state, contrast(frame, region))

    def keep(self, keys: tuple[KeyFrame, ...]) -> None:
        """Close the trackers of all other key frames."""
        known = {id(key.frame) for key in keys}
        self._open = [one for one in self._open if id(one[0].reference) in known]

    def region_now(self, key: KeyFrame) -> Region:
        """Where the tracker of a key frame has last seen the target."""
        tracker = self._of(key)[0]
        tracker.restore(key.inner)
        return tracker.region_now

    def look(
        self, key: KeyFrame, frame: Frame, prediction: Prediction | None, *, afresh: bool
    ) -> tuple[PixelTranslation, Any]:
        """The translation since a key frame, and what its tracker then remembers.

        prediction: counts from the key frame. afresh: the tracker forgets what it had seen.
        """
        tracker, at_rest = self._of(key)
        tracker.restore(at_rest if afresh else key.inner)
        return tracker.push(frame, prediction), tracker.state

    def _of(self, key: KeyFrame) -> tuple[Tracker, Any]:
        """The tracker of a key frame, and its state at rest."""
        for tracker, at_rest in self._open:
            if tracker.reference is key.frame and tracker.region == key.region:
                return tracker, at_rest
        self.key(key.frame, key.region)
        return self._open[-1]
