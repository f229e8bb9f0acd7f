"""The main sleeves: where each is and goes, by the switches of its two valves.

`Sleeves` is the one door. It answers `place`, `stroke` (contact, its deviation and speed),
`from_neutral` (of a stroke from neutral, as a delay), `abort_after_us` and `abort` (a sleeve
stopped in flight), `to_neutral` and `pull_out`. It hears of the valves' switches by `expected`, and
of positions by `take`, from which it learns. Firing a stopped sleeve again is `stroke` once more:
it starts from where the sleeve stands.
"""
