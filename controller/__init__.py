"""The node under test: tooth timestamps in, valve commands out.

`core.ControllerCore` is the whole controller without clock and bus; `node` runs it on a bus.
"""
