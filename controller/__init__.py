"""The node under test: tooth timestamps in, valve commands out.

`core.core.ControllerCore` is the whole controller without clock and bus; `run.node` runs it on a
bus. The rooms, in the order in which a tooth passes them (docs/frame_to_valve.md); each knows those
before it:

    settings     what a run is given: settings, header, what was learned before
    models       equations of motion, their closed forms
    measure      frames to numbered teeth, positions, gears in mesh
    estimate     angle and speed of the shafts; what is learned of teeth and brake; the angle
                 between gear teeth and sleeve teeth
    sleeve       where a main sleeve is and when it meets its gear, from its valves' commands
    plan         when to release the brake and when to fire: the strategies
    shift        the sequence of a shift, and its valve commands
    guard        passes a finished valve command or blocks it
    core         the step, and what is sent and logged about it
    run          on a bus: alone there, what is kept from run to run

Others use `settings`, `core.core`, `run` and the strategies of `plan`; who else looks into a room
is named in an import contract (pyproject.toml). Sensor faults and valve drivers are not here: see
`meshpoint.rig_sim`.
"""
