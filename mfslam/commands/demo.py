"""`mfslam demo`: a simulated fast robot in a few rooms, mapped and compared with the exact truth."""

from __future__ import annotations

import argparse

import numpy as np

from drivers.logs import default_presets, open_log
from drivers.simulator import demo_simulation
from drivers.writers.log import write_log
from drivers.writers.truth import write_tum
from mfslam.commands.map_log import leave, map_log
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for
from mfslam.kernels.warm_up import compile_once
from mfslam.metrics import ate
from mfslam.output import prepare_folder


def run(args: argparse.Namespace) -> int:
    folder, progress = args.output, Progress(args.quiet)
    prepare_folder(folder, overwrite=True)
    progress.tell("simulating a robot at up to 3 m/s, its laser turning at 10 Hz ...")
    simulation = demo_simulation(args.seed)
    path = folder / "demo.mcap"
    write_log(simulation.messages, path, overwrite=True)
    write_tum(folder / "truth.tum", simulation.truth_stamps_ns, simulation.truth_world_T_body)
    compile_once(progress.tell)
    config = config_for(path, args)
    with open_log(path, config) as log:
        outcome = map_log(log, config, progress)
    result = outcome.result
    error = ate(simulation.truth_world_T_body[: len(result.world_T_body)], result.world_T_body)
    result.summary["truth"] = {
        "ate_rms_m": float(np.sqrt(np.mean(error.translation_m**2))),
        "ate_rms_deg": float(np.sqrt(np.mean(error.rotation_deg**2))),
    }
    leave(outcome, config, folder, args.json, args.quiet)
    if not args.quiet:
        truth = result.summary["truth"]
        print(f"truth   {truth['ate_rms_m'] * 1000:.1f} mm and {truth['ate_rms_deg']:.2f} deg from it (RMS)")
        print(f"log     {path}   (map it again: mfslam map {path} -o OUT)")
    return 130 if outcome.interrupted else 0
