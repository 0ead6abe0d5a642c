"""Conditions as flags ask for them."""

from nnql_bullet.run_config import Conditions, RunConfig, changed


def asked_conditions(
    friction: float | None, payload: float | None, noise: float | None, dead_sector: int | None
) -> Conditions | None:
    """The conditions that flags ask for; None if they ask for none."""
    asked = {"wheel_friction": friction, "payload": payload, "sensor_noise": noise, "dead_sector": dead_sector}
    given = {name: value for name, value in asked.items() if value is not None}
    return changed(RunConfig(), conditions=given).conditions if given else None
