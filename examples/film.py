"""Pictures of a flight in MuJoCo, as MP4, as GIF and as a sheet of six."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageDraw

from polhode.geometry.lie import wxyz_from_matrix
from polhode.planning.approach.trajectory import ApproachTrajectory
from polhode.planning.keep_out.volumes import InstantKeepOut

TRAIL_M = 0.006
GIF_SCALE = 0.6
WORDS = "true target; blue: keep-out volume of the run, 99 %; red: inspector; dots: planned trajectory"


class Film:
    """Nothing is shown where no picture can be rendered; that is said once."""

    def __init__(
        self,
        model: Any,
        size: tuple[int, int],
        rate: int,
        volume: InstantKeepOut,
        trajectory: ApproachTrajectory,
    ) -> None:
        import mujoco

        self.mujoco, self.rate, self.volume, self.trajectory = mujoco, rate, volume, trajectory
        self.frames: list[np.ndarray] = []
        try:
            self.renderer = mujoco.Renderer(model, size[1], size[0])
        except Exception as error:  # noqa: BLE001  whatever the graphics driver raises
            print(f"no video: MuJoCo cannot render here ({type(error).__name__}); try MUJOCO_GL=egl")
            self.renderer = None
            return
        self.camera = mujoco.MjvCamera()
        middle = 0.5 * (volume.motion.com_N[0] + volume.motion.com_N[-1])
        self.camera.lookat[:] = middle
        self.camera.distance, self.camera.azimuth, self.camera.elevation = 2.2, 105.0, -12.0

    def add(self, data: Any, time_s: float) -> None:
        """One picture."""
        if self.renderer is None:
            return
        motion = self.volume.motion
        k = int(np.argmin(np.abs(motion.time_s - time_s)))
        data.mocap_pos[0], data.mocap_quat[0] = motion.p_NG[k], wxyz_from_matrix(motion.R_NG[k])
        self.mujoco.mj_forward(self.renderer.model, data)
        self.renderer.update_scene(data, self.camera)
        scene = self.renderer.scene
        for p in self.trajectory.p_N[::2]:
            self.mujoco.mjv_initGeom(
                scene.geoms[scene.ngeom], self.mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, TRAIL_M), p,
                np.eye(3).ravel(), np.array([1.0, 0.8, 0.3, 1.0], dtype=np.float32),
            )  # fmt: skip
            scene.ngeom += 1
        page = Image.fromarray(self.renderer.render())
        pen = ImageDraw.Draw(page)
        pen.text((10, 8), f"{time_s:5.1f} s", fill=(255, 255, 255))
        pen.text((10, page.height - 18), WORDS, fill=(200, 205, 210))
        self.frames.append(np.asarray(page))

    def write(self, folder: Path) -> None:
        """flight.mp4, flight.gif, flight.png."""
        if not self.frames:
            return
        h, w, _ = self.frames[0].shape
        video = cv2.VideoWriter(
            str(folder / "flight.mp4"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), self.rate, (w, h)
        )
        for frame in self.frames:
            video.write(np.ascontiguousarray(frame[..., ::-1]))
        video.release()
        small = [
            Image.fromarray(each).resize((int(w * GIF_SCALE), int(h * GIF_SCALE))).quantize(64)
            for each in self.frames[::3]
        ]
        small[0].save(
            folder / "flight.gif", save_all=True, append_images=small[1:], duration=3000 // self.rate, loop=0
        )
        six = [self.frames[k] for k in np.linspace(0, len(self.frames) - 1, 6).round().astype(int)]
        sheet = np.vstack([np.hstack(six[:3]), np.hstack(six[3:])])
        Image.fromarray(sheet).resize((w * 3 // 2, h)).save(folder / "flight.png")
