"""A phone on a structure, whose camera looks at a fixed target while its box tilts: its film, acceleration and rates.

World axes: right, up, towards the viewer of the screen; upright the phone's own axes are these. Turned to a side its
camera's picture stays upright, as players show it. Nothing here comes from the package.
"""

from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np
from scipy.spatial.transform import Rotation

from lively_recordings import Lively, _film
from phone_logs import BEGUN_NS, GRAVITY_M_S2, phyphox_table, sensor_table
from pinhole_tracks import Course, nothing

# How far the phone is turned about the axis out of its screen, degrees: upright, on either side, upside down.
HELD = {"upright": 0.0, "top to the left": 90.0, "top to the right": -90.0, "upside down": 180.0}
# The camera's axes in the world's: right, down, along the view.
CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
RATE_HZ, RATES_STD = 100.0, np.radians(0.007) * np.sqrt(50.0)
BIAS_RAD_S = np.radians([0.2, -0.1, 0.3])
FOCAL_PX = 2000.0


@dataclass(frozen=True)
class Walk(Lively):
    """A phone held so, at a distance from its target (m), whose box turns by `tilt` about the image's x axis, rad."""

    held: str = "upright"
    distance_m: float = 3.0
    tilt: Course = field(default=nothing)

    @property
    def met_m(self):
        """What an exact pinhole sees of the target, as a displacement that the focal length over the distance makes."""
        t = self.met_s
        turned = Rotation.from_rotvec(np.outer(self.tilt(t), [1.0, 0.0, 0.0])).as_matrix() @ CAMERA.T
        away = np.array([0.0, 0.0, -self.distance_m]) - np.outer(self.motion(t), [0.0, 1.0, 0.0])
        seen = np.einsum("nji,nj->ni", turned, away)
        return 1e-3 * self.mm_per_px * FOCAL_PX * seen[:, 1] / seen[:, 2]

    def readings(self, at):
        """Specific force and rotation rate (n, 3) in the phone's axes at instants (n,)."""
        rng = np.random.default_rng(self.seed)
        rest = Rotation.from_euler("z", HELD[self.held], degrees=True).as_matrix()
        phone = Rotation.from_rotvec(np.outer(self.tilt(at), [1.0, 0.0, 0.0])).as_matrix() @ rest
        force = np.outer(self.motion(at, 2) + GRAVITY_M_S2, [0.0, 1.0, 0.0])
        rate = np.outer(self.tilt(at, 1), [1.0, 0.0, 0.0])
        force, rate = (np.einsum("nji,nj->ni", phone, one) for one in (force, rate))
        noise = rng.normal(0.0, 1.0, (2, len(at), 3))
        return force + self.noise_m_s2 * noise[0], rate + BIAS_RAD_S + RATES_STD * noise[1]

    def files(self, folder: Path, reversed_: bool = False):
        """The files of Sensor Logger; reversed_: with the signs of an iPhone."""
        at = np.arange(round(self.duration_s * RATE_HZ)) / RATE_HZ
        force, rate = self.readings(at)
        platform = "ios,false" if reversed_ else "android,true"
        return {
            "Metadata.csv": f"version,device name,platform,standardisation\n3,phone,{platform}\n",
            "TotalAcceleration.csv": sensor_table(at, -force if reversed_ else force),
            "Gyroscope.csv": sensor_table(at, rate),
            f"Camera/{BEGUN_NS // 1_000_000 + round(1e3 * self.first_s)}.mp4": self.film(folder / "film.mp4"),
        }

    def of_phyphox(self, folder: Path):
        """The files of phyphox, with a film."""
        at = np.arange(round(self.duration_s * RATE_HZ)) / RATE_HZ
        force, rate = self.readings(at)
        names = {"Accelerometer.csv": (force, "m/s^2"), "Gyroscope.csv": (rate, "rad/s")}
        tables = {
            name: phyphox_table(at, value, ("Time (s)", *(f"{axis} ({unit})" for axis in "XYZ")))
            for name, (value, unit) in names.items()
        }
        return tables | {"meta/device.csv": '"property","value"\n', "film.mp4": self.film(folder / "film.mp4")}

    def film(self, path: Path) -> Path:
        """A film without losses of what the camera sees."""
        rng = np.random.default_rng(self.seed)
        film = _film(self, rng)
        film = np.clip(np.rint(film + rng.normal(0.0, 1.0, film.shape)), 0, 255).astype(np.uint8)
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=round(self.rate_hz), options={"qp": "0"})
            stream.height, stream.width, stream.pix_fmt = *film.shape[1:], "gray"
            for picture in film:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
            container.mux(stream.encode())
        return path
