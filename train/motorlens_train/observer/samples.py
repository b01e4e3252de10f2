"""What an observer does at every sample: it adds the sample to its window."""

from motorlens_train.observer.algebra import bend
from motorlens_train.observer.file import WINDOW
from motorlens_train.observer.layout import Layout
from motorlens_train.observer.program import Program, Recorder

# A current is followed as it bends over up to so many windows. No round number: which side of it a step falls on must
# not hang on the last bit of a clock.
BENT = 3.37


def accumulate(layout: Layout) -> Program:
    """The program (voltage, current, ambient, dt, window) -> window, run at every sample."""
    r = Recorder()
    v, i, _, dt = r.inputs(["voltage", "current", "ambient", "dt"])
    alive, v_old, i_old, drag, i_start, time, sum_v, sum_i, sum_ii, sum_b, sum_hh, sum_c, sum_lean, hold = (
        r.inputs(WINDOW)
    )
    h = dt * alive
    first = 1.0 - alive
    # Where in the step the voltage changed nobody knows; what is below three deviations is noise.
    change = ((v - v_old) * (v - v_old) - 18 * layout.v_sd**2).max(0.0) * (1 / 4)
    # The current bends within a step that is not short against L/R; for a voltage that runs linearly the mean over the
    # step is known exactly: (i + i_old)/2 + (tau/h - coth(h/(2 tau))/2)/R times how far the step is from steady state.
    m = layout.motor
    mean, rise = 0.5 * (i + i_old), i - i_old
    mean_square = mean * mean + rise * rise * (1 / 12)
    R = m.resistance(layout.start[layout.at["theta"]])
    turns = h * (mean * (m.ke / m.J) + drag)
    unsteady = (v - v_old) * (0.5 - hold) - R * rise - m.ke * turns
    bent = (h <= BENT * layout.period).select(bend(r, h, m.L / R) * unsteady * (1 / R), 0.0)
    return r.program([
        alive + first, v, i, drag, i_start + first * i, time + h, sum_v + h * 0.5 * (v + v_old), sum_i + h * mean,
        sum_ii + h * mean_square, sum_b + h * bent, sum_hh + h * h, sum_c + h * h * change,
        sum_lean + h * 0.5 * (v - v_old), hold,
    ])  # fmt: skip
