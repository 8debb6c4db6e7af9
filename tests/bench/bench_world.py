"""What a tick of the world costs: 50 robots on the move in a mine of crossing tunnels, every pair's signal strength.

Positions, geometry (ways, corners, line of sight), link budget with fading, contacts; and what a file of measured
strengths costs in place of them. Processor time of this process, so that other load on the machine counts little; the
smallest of several rounds is what the work itself costs.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable

import numpy as np

from netlab.lab.contacts import Contacts
from netlab.lab.motion import TICK_S
from netlab.world.budget import LinkBudget, RadioUnit
from netlab.world.choreography import Choreography
from netlab.world.measured import MeasuredStrengths
from netlab.world.motion import Motion, Walk, Waypoint
from netlab.world.propagation.registry import model_class
from netlab.world.terrain import TunnelMap
from netlab.world.tunnels import Tunnel
from netlab.world.world import World

ROBOTS = 50
ROUNDS = int(os.environ.get("BENCH_ROUNDS", "5"))
TICKS = 200
GOAL_SHARE = 0.10  # of a core, at 10 Hz
_NOISE_DBM, _LEAST_SNR_DB = -91.0, 3.0


def mine() -> TunnelMap:
    """Ten galleries and eight cross-cuts, 50 m apart: 80 crossings."""
    galleries = [Tunnel(f"g{k}", ((0, 50 * k, 0), (350, 50 * k, 0)), 5.0, 3.0) for k in range(10)]
    cuts = [Tunnel(f"c{k}", ((50 * k, 0, 0), (50 * k, 450, 0)), 4.0, 3.0) for k in range(8)]
    return TunnelMap([*galleries, *cuts])


def robots(rng: random.Random) -> dict[str, Motion]:
    """Robots that wander between the galleries at 1 m/s."""

    def place() -> tuple[float, float]:
        return (rng.uniform(0, 350), 50.0 * rng.randrange(10))

    return {f"r{k}": Walk(place(), tuple(Waypoint(place(), 1.0) for _ in range(5))) for k in range(ROBOTS)}


def cost_s(work: Callable[[float], object]) -> float:
    """Processor time of one tick, the least of the rounds."""
    rounds = []
    for _ in range(ROUNDS):
        began_s = time.process_time()
        for tick in range(TICKS):
            work(tick * TICK_S)
        rounds.append((time.process_time() - began_s) / TICKS)
    return min(rounds)


def walk(rng: random.Random) -> MeasuredStrengths:
    """Every pair measured once a second, instead of the link budget."""
    samples = {
        (one, other): [(float(at_s), rng.uniform(-95, -40)) for at_s in range(60)]
        for one in range(ROBOTS)
        for other in range(ROBOTS)
        if one != other
    }
    return MeasuredStrengths(np.full((ROBOTS, ROBOTS), -np.inf), samples, interpolate=True)


def main() -> None:
    """Measure and print."""
    terrain = mine()
    began_s = time.process_time()
    tracks = Choreography(robots(random.Random(1)), (), terrain).tracks()
    build_s = time.process_time() - began_s
    world = World(terrain, tracks)
    model = model_class("tunnel").model_validate({})
    budget = LinkBudget([RadioUnit(f"r{k}", k) for k in range(ROBOTS)], model, seed=1)
    contacts = Contacts(ROBOTS)
    moment = world.moment(30.0)
    geometry = world.geometry(moment, budget.node_of_radio)
    rssi_dbm = budget.rssi_dbm(moment, geometry, 30.0)

    def tick(at_s: float) -> None:
        now = world.moment(at_s)
        strengths = budget.rssi_dbm(now, world.geometry(now, budget.node_of_radio), at_s)
        contacts.update(strengths - _NOISE_DBM >= _LEAST_SNR_DB, at_s)

    rows = {
        "positions": cost_s(world.moment),
        "geometry": cost_s(lambda _at_s: world.geometry(moment, budget.node_of_radio)),
        "link budget": cost_s(lambda at_s: budget.rssi_dbm(moment, geometry, at_s)),
        "measured": cost_s(walk(random.Random(2)).rssi_dbm),
        "contacts": cost_s(lambda at_s: contacts.update(rssi_dbm - _NOISE_DBM >= _LEAST_SNR_DB, at_s)),
        "all": cost_s(tick),
    }
    print(f"{ROBOTS} robots, {len(terrain.tunnels)} tunnels; tracks built in {build_s * 1e3:.0f} ms")
    print(f"{'':14} ms per tick   of a core at 10 Hz   at {1 / TICK_S:.0f} Hz")
    for name, each_s in rows.items():
        print(f"{name:14} {each_s * 1e3:11.2f} {each_s * 10:20.1%} {each_s / TICK_S:9.1%}")
    verdict = "met" if rows["all"] * 10 <= GOAL_SHARE else "NOT met"
    print(
        f"goal: at most {GOAL_SHARE:.0%} of a core at 10 Hz: {verdict}; {int(np.isfinite(rssi_dbm).sum())} pairs heard"
    )


if __name__ == "__main__":
    main()
