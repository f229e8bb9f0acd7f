"""The node under test: tooth timestamps in, valve commands out.

`core.ControllerCore` is the whole controller without clock and bus; `node` runs it on a bus. The
rooms, in the order in which a tooth passes them (docs/frame_to_valve.md):

    sensing      frames to numbered teeth, positions, gears in mesh
    motion       equations of motion, their closed forms
    estimation   angle and speed of the shafts; what is learned of teeth and brake
    phase        the angle between gear teeth and sleeve teeth
    sleeve       where a main sleeve is and when it meets its gear, from its valves' commands
    planning     when to release the brake and when to fire: one file for each strategy
    shift        the sequence of a shift, and its valve commands
    guard        passes a finished valve command or blocks it
    report       what is sent and logged about it
    calibration  what has been learned, kept from run to run
    xcp          a calibration tool's measured values and settings, where the run has them (--xcp)

Others use the modules on this floor and `planning.strategies`; who else looks into a room is named
in an import contract (pyproject.toml). `settings` has every setting. Sensor faults and valve
drivers are not here: see `meshpoint.rig_sim`.
"""
