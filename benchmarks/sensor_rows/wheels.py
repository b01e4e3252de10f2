"""Rows on real recordings, where they are at hand: wheel motors of a robot, and what has no current."""

from collections.abc import Mapping
from dataclasses import replace

from sensor_rows.common import MELLAH, ROOT, Network, Observing, Size, better, filters, goal, show

from motorlens_physics.estimate.calibrate import calibrate
from motorlens_physics.motor_file import MotorFile, with_overrides
from motorlens_physics.recording import read_recording
from motorlens_train.baselines import ExtendedKalman, Method, SteadyStateVoltage
from motorlens_train.baselines.extended_kalman import noise_of
from motorlens_train.build import Recipe, build
from motorlens_train.data import cycle
from motorlens_train.evaluation.scores import evaluate
from motorlens_train.material import from_recordings
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.specification import Rate
from motorlens_train.trainer import Settings

RECORDINGS = ROOT.parent / "shared" / "recordings"


def wheels(size: Size, quick: bool) -> None:
    """Real wheel motors: trained on robots 01 and 03, tested on 04 and 05."""
    if not RECORDINGS.is_dir():
        print("\n## real wheel motors: the recordings are not here")
        return
    columns = ("voltage=vL_V", "current=iL_A", "speed=wL_rad_s")
    runs = {k: read_recording(RECORDINGS / "regbot" / f"robot_{k:02d}.csv", columns) for k in (1, 3, 4, 5)}
    bench = [runs[1], runs[3]]
    plain = wheel_file()
    # Friction and a drop at brushes and driver are known to be there; the bench says how large they are.
    effects = {
        "coulomb_friction.tau_c": 0.01, "coulomb_friction.w_s": 0.5, "brush_voltage_drop.V_b": 0.3,
        "brush_voltage_drop.i_s": 0.02,
    }  # fmt: skip
    keys = ["R_a0", "L", "ke", "J", "b", "coulomb_friction.tau_c", "brush_voltage_drop.V_b"]
    file = calibrate(with_overrides(plain, effects), bench, keys).file
    v_sd, i_sd = noise_of(bench, file.rated)
    # Two runs of half a second support a linear correction, no more.
    bank = with_observer(
        filters(file), file, ObserverSettings(voltage_sd=v_sd, current_sd=i_sd, model_sd=0.03, load_walk=0.05)
    )
    outputs = ("speed",)
    seen = [cycle(r, bank, outputs) for r in bench]
    recipe = Recipe(
        "wheel", bank, outputs, (), Rate(1000.0, 500.0, 2000.0), 0.1, 0,
        Settings(iterations=60, time_series=True, single=False, ridge=1.0),
    )  # fmt: skip
    names = [str(RECORDINGS / "regbot" / f"robot_{k:02d}.csv") for k in (1, 3)]
    plain_recordings = from_recordings(names, columns, "wheel", 1, None, 120)
    cascade = build(plain_recordings.recipe, plain_recordings.training, plain_recordings.calibration, [])
    methods: Mapping[str, Method] = {
        "cascade": Network(cascade.sensor),
        "hybrid": Network(build(recipe, seen, [], []).sensor),
        "observer alone": Observing(bank, file),
        "EKF, same motor file": ExtendedKalman(refit=False).fit(bench, file),
        "EKF, textbook fitted": ExtendedKalman().fit(bench, plain),
        "steady-state voltage": SteadyStateVoltage().fit(bench, plain),
    }
    for robot in (4, 5):
        found = evaluate(methods, [runs[robot]], file)
        show(f"regbot robot {robot:02d}, left wheel, trained on robots 01 and 03", found)
        better("below the EKF fitted to the same recordings", found, "cascade", "EKF, textbook fitted")
        better("below the EKF of the same motor file", found, "cascade", "EKF, same motor file")
        goal("speed of the cascade, rms (rad/s)", found.scores["cascade"]["speed"].rms, 1.5)


def fra233(size: Size, quick: bool) -> None:
    """What cannot be judged is said."""
    print(
        "\n## fra233: not judged; these recordings hold no current, and the sensor needs voltage and current"
    )


def wheel_file() -> MotorFile:
    """What is documented of the robots' wheel motors, at the wheel; the friction is known to be there, not how large."""
    file = MELLAH.with_values(
        {
            "R_a0": 3.0,
            "L": 0.0066,
            "ke": 0.1016,
            "J": 5e-4,
            "b": 1e-4,
            "H": 20.0,
            "k0": 0.1,
            "k_ir": 0.0,
            "kT": 0.0,
        }
    )
    rated = replace(file.rated, voltage_V=12.0, current_A=0.5, speed_rad_s=100.0, torque_Nm=0.05, rise_K=30.0)
    sds = {
        key: replace(file.knowledge[key], sd=0.5 * file.values()[key])
        for key in ("R_a0", "L", "ke", "J", "b")
    }
    return replace(file, rated=rated, knowledge={**file.knowledge, **sds})
