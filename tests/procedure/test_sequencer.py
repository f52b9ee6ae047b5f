# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.procedure.events import (
    Aimed,
    Arrived,
    Captured,
    CaptureFailed,
    Motion,
    MovedAway,
    Phase,
    Refused,
    State,
    Stop,
    Timing,
)

from .procedures import TEXT, small
from .world import SECOND, World

QUICK = Timing(paced=False, resend=0.5, answer=0.5, patience=5.0)


def test_measures_every_step():
    world = World(small())
    world.run()
    assert world.sequencer.state is State.FINISHED
    world.check()
    assert world.sequencer.counters == {"resent": 0, "stale": 0, "unstable": 0, "recoveries": 0, "restarts": 0}


def test_commands_of_the_next_step_leave_before_the_reading_is_published():
    world = World(small())
    actions = []
    do = world.do
    world.do = lambda some: (actions.append([type(action).__name__ for action in some]), do(some))
    world.run()
    assert ["Motion", "Aim", "Emit"] in actions


@pytest.mark.long
@given(st.integers(0, 10**6), st.floats(0.0, 0.15), st.integers(0, 12))
def test_never_pairs_wrongly_however_messages_come(seed, loss, disorder):
    world = World(small(), seed, loss, disorder)
    world.run()
    assert world.sequencer.state is State.FINISHED, world.sequencer.message
    world.check()


@pytest.mark.long
@given(
    st.integers(0, 10**6),
    st.lists(
        st.tuples(st.integers(1, 400), st.sampled_from(["lose_datum", "restart_instrument", "restart_axes"])),
        max_size=3,
    ),
    st.integers(0, 8),
)
def test_broken_beams_and_restarts_in_the_middle(seed, mishaps, disorder):
    world = World(small(), seed, 0.02, disorder)

    def before():
        for turn, mishap in list(mishaps):
            if world.turn >= turn:
                getattr(world, mishap)()
                mishaps.remove((turn, mishap))

    world.before = before
    world.run()
    assert world.sequencer.state is State.FINISHED, world.sequencer.message
    world.check()


def test_a_lost_beam_is_tied_to_known_targets():
    world = World(small())
    world.before = lambda: len(world.emitted) == 9 and world.datum.endswith("-1") and world.lose_datum()
    world.run()
    world.check()
    assert world.sequencer.counters["recoveries"] == 1
    datums = [emit.columns["datum"] for emit in world.emitted]
    assert datums == [0.0] * 9 + [1.0] * 3 + [2.0] * 12


def test_a_paused_procedure_is_finished_with_what_was_measured():
    world = World(small())
    world.before = lambda: len(world.emitted) == 7 and world.sequencer.pause()
    world.run()
    assert world.sequencer.state is State.PAUSED
    world.sequencer.finish()
    assert world.sequencer.state is State.FINISHED
    assert world.sequencer.message == f"finished after 7 of {len(world.plan.steps)} readings"
    world.run()
    assert len(world.emitted) == 7


def test_a_datum_that_does_not_fit_ends_in_an_error():
    world = World(small())
    deliver, count = world.deliver, [0]

    def delivered(to, content):
        if len(world.emitted) == 9 and world.datum.endswith("-1"):
            world.lose_datum()
        if isinstance(content, Captured) and world.datum.endswith("-2"):
            count[0] += 1
            # the instrument has been pushed: it moves on between the targets
            content = Captured(**{**vars(content), "displacement": content.displacement + 1e-4 * count[0]})
        deliver(to, content)

    world.deliver = delivered
    world.run()
    assert world.sequencer.state is State.ERROR
    assert "the datum could not be found again" in world.sequencer.message
    assert len(world.emitted) == 9


@pytest.mark.parametrize("partner", ["axes", "pointer", "instrument"])
def test_a_partner_that_died_is_named_and_the_procedure_can_be_resumed(partner):
    world = World(small(), timing=QUICK)
    world.before = lambda: len(world.emitted) == 5 and world.dead.add(partner)
    world.run()
    assert world.sequencer.state is State.ERROR
    name = "rotary pointer" if partner == "pointer" else partner
    assert world.sequencer.message == f"no answer from {name} for 5 s"
    world.dead, world.before = set(), lambda: None
    world.do(world.sequencer.resume(world.clock, world.wall))
    world.run()
    assert world.sequencer.state is State.FINISHED
    world.check()


class Slow(World):
    """Its instrument answers every request later than the procedure repeats it."""

    DELAY = 1.2 * QUICK.answer

    def run(self, turns=200_000):
        self.late = []
        super().run(turns)

    def post(self, to, content):
        if to == "procedure" and hasattr(content, "token"):
            self.late.append((self.wall + self.DELAY, content))
        else:
            super().post(to, content)

    def heartbeat(self):
        super().heartbeat()
        for due, content in [entry for entry in self.late if entry[0] <= self.wall]:
            self.late.remove((due, content))
            self.deliver("procedure", content)


@pytest.mark.parametrize("mishap", ["", "lose_datum", "restart_instrument", "restart_axes"])
def test_an_instrument_that_answers_late_is_heard(mishap):
    world = Slow(small(), timing=QUICK)
    mishaps = [mishap] if mishap else []
    world.before = lambda: len(world.emitted) == 9 and mishaps and getattr(world, mishaps.pop())()
    world.run()
    assert world.sequencer.state is State.FINISHED, world.sequencer.message
    world.check()
    assert world.sequencer.counters["resent"] >= len(world.plan.steps)


def test_pause_and_resume():
    """A step that was interrupted is approached from the place before it."""
    world = World(small())
    world.before = lambda: len(world.emitted) == 7 and world.sequencer.pause()
    world.run()
    assert world.sequencer.state is State.PAUSED
    world.mail.clear()
    world.before = lambda: None
    before, step = world.plan.steps[6:8]
    motion, aim = world.sequencer.resume(world.clock, world.wall)
    assert before.position != step.position
    assert [point.position for point in motion.points] == [before.position, step.position, step.position]
    world.do([motion, aim])
    world.run()
    world.check()


def test_late_answers_after_a_pause_belong_to_nothing():
    world = World(small())
    world.do(world.sequencer.start(world.clock, world.wall))
    world.sequencer.pause()
    for event in (Arrived(world.clock, world.clock, world.clock + SECOND), Aimed("A", 0.0, 0.0, world.clock)):
        assert world.sequencer.handle(event, world.clock, world.wall) == []


def test_abort_stops_the_axes():
    world = World(small())
    world.do(world.sequencer.start(world.clock, world.wall))
    assert [type(action).__name__ for action in world.sequencer.abort(world.clock)] == ["Stop"]
    assert world.sequencer.state is State.ABORTED
    assert world.sequencer.message == "aborted after 0 of 24 readings"


def test_a_start_after_an_abort_commands_something_new_where_the_clock_still_stands():
    """A command is known by its stamp: one of the same as the stop's passes for a repeated stop."""
    world = World(small())
    world.do(world.sequencer.start(world.clock, 0.0))
    (stop,) = world.sequencer.abort(world.clock)
    (motion,) = (a for a in world.sequencer.start(world.clock, 0.0) if isinstance(a, Motion))
    assert world.clock < stop.stamp < motion.stamp


def test_no_command_has_the_identity_of_one_of_a_probe():
    """Both may command the axes at the same moment: the procedure's stamps are even, a probe's odd."""
    world = World(small())
    for clock in (world.clock, world.clock + 1):
        stop_and_go = [*world.sequencer.start(clock, 0.0), *world.sequencer.abort(clock)]
        stamps = [action.stamp for action in stop_and_go if isinstance(action, Motion | Stop)]
        assert len(stamps) == 2 and all(stamp % 2 == 0 for stamp in stamps)


def begun(world):
    """The first command of the axes, and what hands an event to the procedure."""
    motion, _aim = world.sequencer.start(world.clock, world.wall)
    return motion, lambda event: world.sequencer.handle(event, world.clock, world.wall)


def test_a_refused_command_is_an_error_with_its_reason():
    world = World(small())
    motion, handle = begun(world)
    handle(Refused(motion.stamp + 1, "another command"))
    assert world.sequencer.state is State.RUNNING
    handle(Refused(motion.stamp, "refused: x = 9"))
    assert (world.sequencer.state, world.sequencer.message) == (State.ERROR, "axes: refused: x = 9")


def test_waits_for_the_instrument_to_be_moved():
    world = World(small(), timing=Timing(paced=False, wait_between_setups=True))
    world.run()
    assert world.sequencer.state is State.PAUSED
    assert world.sequencer.message == "bring the instrument to setup B, then resume"
    assert len(world.emitted) == 12
    world.do(world.sequencer.resume(world.clock, world.wall))
    world.run()
    world.check()


def test_waits_in_a_setup_for_who_decides_whether_it_is_enough():
    """After every fifth reading of a setup, counted anew in each; what is measured is the same."""
    world = World(small(), timing=Timing(paced=False, wait_every=5))
    world.run()
    stops = []
    while world.sequencer.state is State.PAUSED:
        stops.append((len(world.emitted), world.sequencer.message))
        world.do(world.sequencer.resume(world.clock, world.wall))
        world.run()
    assert stops == [
        (first + readings, f"{readings} readings of setup {setup}: resume or finish")
        for first, setup in ((0, "A"), (12, "B"))
        for readings in (5, 10)
    ]
    world.check()


@pytest.mark.parametrize("leapt", [True, False])
def test_a_slow_pointer_makes_the_axes_wait_where_time_was_leapt_over(leapt):
    """In real time path and air are as steady as when the axes arrived."""
    world = World(small())
    motion, handle = begun(world)
    assert handle(Arrived(motion.stamp, motion.stamp + SECOND, motion.stamp + (1 + leapt) * SECOND, "a")) == []
    late = motion.stamp + 5 * SECOND
    first, *_again = handle(Aimed("A", *world.sequencer.pending.angles, late))
    if leapt:
        assert isinstance(first, Motion) and len(_again) == 1
        assert first.stamp >= late
        assert first.points[-1].position == motion.points[-1].position
    else:
        assert first.phase is Phase.DATUM and not _again


def test_commands_carry_times_for_a_real_controller():
    world = World(small(), timing=Timing(paced=True))
    (motion, _) = world.sequencer.start(world.clock, world.wall, {"x": 0.2, "y": 0.2})
    times = [clock for _, clock in motion.points]
    assert times == sorted(set(times))
    assert times[0] > 0.2 / 0.25  # 0.195 m at 0.25 m/s, with the ramps
    assert times[-1] - times[-2] == pytest.approx(1.0)


def test_an_unsteady_path_is_given_time_and_then_up():
    """By the count of attempts, which begins anew with a start after an abort."""
    world = World(small())
    for _ in range(2):
        motion, handle = begun(world)
        for attempt in range(4):
            handle(Aimed("A", *world.sequencer.pending.angles, motion.stamp))
            (request,) = handle(Arrived(motion.stamp, motion.stamp + 1, motion.stamp + 2 * SECOND, "a"))
            assert request.phase is Phase.DATUM
            world.clock += 2 * SECOND
            actions = handle(CaptureFailed(request.token, "unstable", "the path still changes"))
            motion = actions[0] if attempt < 3 else motion
        assert actions == []
        assert (world.sequencer.state, world.sequencer.message) == (State.ERROR, "instrument: the path still changes")
        world.sequencer.abort(world.clock)
        world.clock += 2 * SECOND


def test_three_dimensions_point_upwards():
    text = TEXT.replace("dimension: 2", "dimension: 3").replace("y: [0.1, 0.2]}", "y: [0.1], z: [0.05]}")
    world = World(small(text))
    motion, handle = begun(world)
    azimuth, elevation = world.sequencer.pending.angles
    assert elevation == pytest.approx(math.atan2(0.05, math.hypot(0.35, 0.05)))
    assert azimuth == pytest.approx(math.atan2(0.05, 0.35))
    handle(Arrived(motion.stamp, motion.stamp + SECOND, motion.stamp + 2 * SECOND, "a"))
    for wrong in ((azimuth, -elevation), (-azimuth, elevation), (azimuth, 0.0)):
        assert handle(Aimed("A", *wrong, motion.stamp)) == [], "it points elsewhere"
    (request,) = handle(Aimed("A", azimuth, elevation, motion.stamp))
    assert request.phase is Phase.DATUM


def jogged(stamp, times=1):
    """A world in which another command moves the axes between their arrival and the reading."""
    world = World(small())
    asked, left = world.asked, [times]

    def asked_too_late(request):
        if len(world.emitted) == 3 and left[0]:
            left[0] -= 1
            before = world.clock
            world.clock += SECOND
            world.axes["x"] += 5e-4
            world.moves.append(Motion(world.clock - 1, ()))
            world.heard["axes"] = world.clock, (world.clock, dict(world.axes))
            world.do(world.sequencer.handle(MovedAway(stamp(before), "a1"), world.clock, world.wall))
        asked(request)

    world.asked = asked_too_late
    world.run()
    return world


def test_no_reading_is_taken_where_another_command_brought_the_axes():
    world = jogged(lambda before: before + SECOND)
    assert world.sequencer.state is State.FINISHED
    world.check()
    assert world.sequencer.counters["unstable"] == 1


def test_who_moves_the_axes_again_and_again_ends_in_an_error():
    world = jogged(lambda before: before + SECOND, times=4)
    assert world.sequencer.state is State.ERROR
    assert world.sequencer.message == "axes: another command moves them while a reading is taken"


def test_what_was_said_of_the_axes_before_they_arrived_moves_nothing():
    assert jogged(lambda before: before, times=1).sequencer.counters["unstable"] == 0
