"""Lists all probes by name, and runs them."""

from collections.abc import Iterator
from math import nan

from nnql_bullet.errors import UserError
from nnql_bullet.fidelity.probe import Bench, Measurement, Probe
from nnql_bullet.fidelity.probes_body import BODY
from nnql_bullet.fidelity.probes_contact import CONTACT
from nnql_bullet.fidelity.probes_rolling import ROLLING
from nnql_bullet.fidelity.probes_senses import SENSES
from nnql_bullet.vehicle.spec import VehicleSpec

PROBES: dict[str, Probe] = {probe.name: probe for probe in (*BODY, *ROLLING, *CONTACT, *SENSES)}


def probes_for(vehicle: VehicleSpec) -> list[Probe]:
    """Returns the probes whose formulas hold for a vehicle."""
    return [probe for probe in PROBES.values() if probe.applies(vehicle)]


def run_probes(bench: Bench) -> Iterator[tuple[Probe, list[Measurement]]]:
    """Runs all probes that apply one after the other.

    If a probe raises an error, for example because the vehicle fell over, its only measurement is NaN, which is never
    accepted; the name of the measurement is the reason.

    Yields:
        Each probe with its measurements.

    Raises:
        UserError: If the engine is not installed or cannot start.
    """
    for probe in probes_for(bench.vehicle):
        yield probe, _measured(probe, bench)


def _measured(probe: Probe, bench: Bench) -> list[Measurement]:
    try:
        return probe.measure(bench)
    except UserError:
        raise
    except Exception as error:  # a wrong vehicle or engine may raise anything
        reason = str(error).partition("\n")[0]
        return [Measurement(f"broke off: {type(error).__name__}: {reason}", "", nan, nan, nan, nan)]
