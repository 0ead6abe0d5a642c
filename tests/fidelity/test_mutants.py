"""A suite is worth the faults that it finds: each of these has to turn the probes red that are there for it."""

import pytest
from mutants import FAULTS, Fault, FaultyBench

from nnql_bullet.fidelity.probes import PROBES
from nnql_bullet.vehicle.spec import VehicleSpec


def reds(bench: FaultyBench, probe: str) -> list[str]:
    return [f"{row.quantity}: {row.measured}" for row in PROBES[probe].measure(bench) if not row.ok]


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_seen(vehicle: VehicleSpec, name: str) -> None:
    fault = FAULTS[name]
    blind = [probe for probe in fault.seen_by if not reds(FaultyBench(vehicle, fault=fault), probe)]
    assert not blind


def test_without_a_fault_the_same_bench_is_green(vehicle: VehicleSpec) -> None:
    bench = FaultyBench(vehicle, fault=Fault((), urdf=lambda robot: None))
    assert not {probe: found for probe in PROBES if (found := reds(bench, probe))}


def test_every_probe_sees_a_fault_and_every_fault_is_seen() -> None:
    assert {probe for fault in FAULTS.values() for probe in fault.seen_by} == set(PROBES)
    assert all(fault.seen_by for fault in FAULTS.values())
