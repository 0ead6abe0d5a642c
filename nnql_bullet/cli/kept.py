"""Where verbs keep drives, and as what."""

from pathlib import Path

from nnql_bullet.recording import Recording
from nnql_bullet.reports.plots import draw_trajectory
from nnql_bullet.run_config import key_texts
from nnql_bullet.runs import drives_folder
from nnql_bullet.setting import Setting

RECORDING = "trajectory.npz"
"""File that a drive is kept in."""


def keep(recording: Recording, folder: Path) -> dict[str, Path]:
    """Writes a recording and its picture into a folder, which is made if it is not there; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {"recording": folder / RECORDING, "picture": (folder / RECORDING).with_suffix(".png")}
    recording.save(files["recording"])
    draw_trajectory(recording, files["picture"])
    return files


def drive_folder(policy: Path, world: str, seed: int, setting: Setting) -> Path:
    """The folder in which a drive is kept: with its run, named for the world and for what was asked for."""
    simulator = [setting.simulator] if setting.simulator != "bullet" else []
    parts = [world, str(seed), *simulator, *(["shield"] if setting.shield else []), *(["plan"] if setting.plan else [])]
    asked = (setting.conditions.texts if setting.conditions else {}) | key_texts(dict(setting.keys))
    parts += [f"{name.replace('_', '-')}-{text}" for name, text in asked.items()]
    return drives_folder(policy) / "-".join(parts)
