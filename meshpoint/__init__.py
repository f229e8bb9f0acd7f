"""meshpoint: a transmission controller that fires a sleeve so that tooth meets gap, and a rig.

    meshpoint.controller   the node under test; in the repository the folder controller/
    meshpoint.rig_sim      the virtual gearbox; rig_sim/
    meshpoint.dbc          the wire contract; dbc/
    meshpoint.gearbox      the data sheet
    meshpoint.bus          how frames travel
    meshpoint.testbench    controller and rig on one bench, and the command line

docs/decisions/0012-one-name.md says why three of them lie beside this folder in the repository.
"""
