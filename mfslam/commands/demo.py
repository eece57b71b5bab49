"""`mfslam demo`: a simulated fast robot in a few rooms, mapped and compared with the exact truth."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from drivers.logs import open_log
from drivers.simulator import Simulation, demo_simulation
from drivers.writers.log import write_log
from drivers.writers.truth import write_tum
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.map_log import map_log, say
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for
from mfslam.kernels.warm_up import compile_once
from mfslam.metrics import associate, ate
from mfslam.outcome import Outcome, leave
from mfslam.output import check_writable, run_folder

LOG, TRUTH = "demo.mcap", "truth.tum"


def run(args: argparse.Namespace) -> int:
    folder: Path = args.output
    progress = Progress(args.quiet)
    again = (folder / TRUTH).is_file()  # an earlier demo, which may be replaced
    with run_folder(folder, args.overwrite or again):
        if args.json is not None:
            check_writable(args.json)
        compile_once(progress.tell)
        progress.tell("simulating a robot at up to 3 m/s, its laser turning at 10 Hz ...")
        simulation = demo_simulation(args.seed)
        path = folder / LOG
        write_log(simulation.messages, path, overwrite=True)
        write_tum(folder / TRUTH, simulation.truth_stamps_ns, simulation.truth_world_T_body)
        config = config_for(path, args)
        start_cpu_s = time.process_time()  # the simulation is no part of the mapping
        with open_log(path, config) as log, Interrupts() as interrupts:
            outcome = map_log(log, config, progress, interrupts, start_cpu_s)
            compare(outcome, simulation)
            leave(outcome, config, folder, args.json)
    if not args.quiet:
        truth = outcome.summary["truth"]
        print(
            f"error   {truth['ate_rms_m'] * 1000:.1f} mm and {truth['ate_rms_deg']:.2f} deg (RMS), by exact truth"
        )
        say(outcome, folder)
        print(f"log     {path}   (as from a robot: mfslam map {path} -o OUT)")
    return 130 if outcome.interrupted else 0


def compare(outcome: Outcome, simulation: Simulation) -> None:
    """Put the error against the truth into the run's summary."""
    result = outcome.result
    true, estimated = associate(simulation.truth_stamps_ns, result.stamps_ns)
    error = ate(simulation.truth_world_T_body[true], result.world_T_body[estimated])
    truth = {"ate_rms_m": error.translation_m.rmse, "ate_rms_deg": error.rotation_deg.rmse}
    result.summary["truth"] = outcome.summary["truth"] = truth
