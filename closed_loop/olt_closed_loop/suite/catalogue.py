"""The events of the suite by name: category, factors, and how each is made.

The 53 stand in the paper's proportion, 8 : 2 : 6 : 2 (docs/formats/paper.md). What `evaluation.suite_check` promises
is checked for seeds 0, 1 and 2 of each; others are made the same way.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from olt_closed_loop.scenes.maps.lanes import Control
from olt_closed_loop.suite import cyclists, extras, intersections, vehicles, work_zones
from olt_closed_loop.suite.event import Make, behind_a_crest, in_mirror
from olt_closed_loop.suite.intersections import five, four, skewed, three, wye
from olt_generator.errors import InputError

REASSIGNED, GUIDED, CONED = "temporary_path_reassignment", "human_guided_traffic_control", "cone_delineated_path"
CURVED, IRREGULAR, WEAK = "curved_road", "irregular_layout", "weak_markings"
PRIORITY, TAKEN, ONCOMING = "cross_traffic_first", "cross_traffic_takes_way", "oncoming_traffic"
LEFT, LIGHTS, HILLS = "left_hand_traffic", "traffic_lights", "hills"
FACTORS: Mapping[str, str] = {
    REASSIGNED: "cones, closures or routing override the markings",
    GUIDED: "somebody directs traffic by arms or a sign",
    CURVED: "the road bends where it matters",
    IRREGULAR: "the junction is no plain crossroads",
    WEAK: "most of the paint is gone",
    CONED: "cones mark the border of the way",
    PRIORITY: "cross traffic goes first, by right or because somebody lets it",
    TAKEN: "somebody takes the way whose right it is not",
    ONCOMING: "oncoming traffic bounds when the ego can go",
    LEFT: "traffic keeps to the left",
    LIGHTS: "lamps show who may go, or somebody overrules them",
    HILLS: "the event is behind a crest of the road",
}
"""The factors by which tables have rows, and what they mean."""

CATEGORIES = ("complex_intersection", "cyclists", "uncommon_vehicle", "work_zone")
"""The paper's categories; events of others are beside the 53."""


@dataclass(frozen=True)
class Entry:
    """One event of the catalogue.

    Attributes:
        name: of the event, and with its seed of the scene.
        category: the paper's, or one beside them.
        factors: which of FACTORS hold.
        make: makes the event from a generator.
    """

    name: str
    category: str
    factors: tuple[str, ...]
    make: Make


Row = tuple[str, tuple[str, ...], Make]
_hold, _detour, _give = intersections.directed_hold, intersections.directed_detour, intersections.give_way
_taken, _across, _coned = intersections.way_taken, intersections.turn_across, intersections.coned_path
_people, _ring, _exit = intersections.people_cross, intersections.ring_entry, intersections.blocked_exit
Controls = tuple[Control, ...]
WORN = 0.85
_LIGHT4: Controls = ("light", "light", "light", "light")
_STOP4: Controls = ("priority", "stop", "priority", "stop")
_STOP3: Controls = ("priority", "priority", "stop")
_MAIN4: Controls = ("stop", "priority", "stop", "priority")


_COMPLEX: tuple[Row, ...] = (
    (
        "officer_overrules_light",
        (GUIDED, PRIORITY, LIGHTS),
        partial(_hold, roads=partial(four, goal=1, controls=_LIGHT4), streams=((2, 0),), waiting=0, overruled=True),
    ),
    (
        "officer_stops_both_ways",
        (GUIDED, PRIORITY, WEAK),
        partial(_hold, roads=partial(four, goal=1, wear=WORN), streams=((2, 0), (0, 2))),
    ),
    (
        "officer_stops_left_turn",
        (GUIDED, PRIORITY),
        partial(_hold, roads=partial(four, goal=2), streams=((1, 3), (0, 2))),
    ),
    (
        "officer_at_skewed_junction",
        (GUIDED, PRIORITY, IRREGULAR),
        partial(_hold, roads=partial(skewed, goal=1), streams=((0, 2),), waiting=2),
    ),
    (
        "officer_at_three_arms",
        (GUIDED, PRIORITY, IRREGULAR),
        partial(_hold, roads=partial(three, goal=1), streams=((0, 1), (1, 0))),
    ),
    ("officer_past_breakdown", (GUIDED, REASSIGNED, CONED), partial(_exit, roads=partial(four, goal=1), side=1.0)),
    (
        "officer_past_breakdown_bend",
        (GUIDED, REASSIGNED, CURVED),
        partial(_exit, roads=partial(skewed, goal=1, bend=0.006), side=1.0),
    ),
    ("worker_detour", (GUIDED, REASSIGNED, CONED), partial(_detour, roads=partial(four, goal=1), side=1.0)),
    (
        "worker_detour_before_left_turn",
        (GUIDED, REASSIGNED, CONED, WEAK),
        partial(_detour, roads=partial(four, goal=2, wear=WORN), side=1.0),
    ),
    (
        "worker_detour_five_arms",
        (GUIDED, REASSIGNED, CONED, IRREGULAR),
        partial(_detour, roads=partial(five, goal=1), side=1.0),
    ),
    ("coned_path_across", (REASSIGNED, CONED), partial(_coned, roads=partial(four, goal=1), side=1.0)),
    (
        "coned_path_weak_markings",
        (REASSIGNED, CONED, WEAK, CURVED),
        partial(_coned, roads=partial(skewed, goal=1, wear=WORN, bend=0.005), side=1.0),
    ),
    (
        "stop_sign_crossing",
        (PRIORITY,),
        partial(_give, roads=partial(four, goal=1, controls=_STOP4), streams=((2, 0), (0, 2))),
    ),
    (
        "stop_sign_left_turn",
        (PRIORITY, IRREGULAR),
        partial(_give, roads=partial(three, goal=1, controls=_STOP3), streams=((0, 1), (1, 0))),
    ),
    (
        "wye_merge",
        (PRIORITY, IRREGULAR, CURVED),
        partial(_give, roads=partial(wye, goal=1, bend=0.006), streams=((0, 1),)),
    ),
    (
        "left_hand_crossing",
        (PRIORITY, LEFT),
        in_mirror(partial(_give, roads=partial(four, goal=1, controls=_STOP4), streams=((2, 0), (0, 2)))),
    ),
    (
        "way_taken_from_left",
        (TAKEN, LIGHTS),
        partial(_taken, roads=partial(four, goal=1, lit=True), start=2, goal=0),
    ),
    (
        "way_taken_from_right",
        (TAKEN, WEAK),
        partial(_taken, roads=partial(skewed, goal=1, controls=_MAIN4, wear=WORN), start=0, goal=2),
    ),
    (
        "left_turn_across",
        (ONCOMING, LIGHTS),
        partial(_across, roads=partial(four, goal=2, lit=True), start=1, goal=3),
    ),
    (
        "left_turn_across_curve",
        (ONCOMING, CURVED, IRREGULAR),
        partial(_across, roads=partial(skewed, goal=2, bend=0.006), start=1, goal=3),
    ),
    (
        "roundabout_busy",
        (PRIORITY, IRREGULAR, CURVED),
        partial(_ring, headings=(0.0, 90.0, 180.0, 270.0), goal=1, start=2, leave=0),
    ),
    (
        "roundabout_three_arms",
        (PRIORITY, IRREGULAR, CURVED, LEFT),
        in_mirror(partial(_ring, headings=(30.0, 150.0, 270.0), goal=0, start=1, leave=0)),
    ),
    ("people_cross_right_turn", (IRREGULAR,), partial(_people, roads=partial(five, goal=0), group=3)),
    ("people_cross_left_turn", (), partial(_people, roads=partial(four, goal=2), group=4)),
)

_CYCLISTS: tuple[Row, ...] = (
    (
        "riders_on_curve",
        (CURVED, ONCOMING),
        partial(cyclists.riders_ahead, riders=1, abreast=False, curve=1 / 120, traffic=True),
    ),
    ("riders_abreast", (ONCOMING,), partial(cyclists.riders_ahead, riders=2, abreast=True, curve=0.0, traffic=True)),
    ("rider_crosses", (TAKEN,), partial(cyclists.rider_crosses, side=-1.0)),
    ("rider_swerves", (LEFT,), in_mirror(cyclists.rider_swerves)),
    ("rider_against", (TAKEN, HILLS), behind_a_crest(cyclists.rider_against)),
    ("turn_over_rider", (PRIORITY,), cyclists.turn_over_rider),
)

_VEHICLES: tuple[Row, ...] = (
    (
        "tractor_ahead",
        (ONCOMING,),
        partial(vehicles.slow_vehicle, size=(4.6, 2.3, 2.9), speed=3.8, curve=0.0, traffic=True),
    ),
    (
        "tractor_on_curve",
        (CURVED, HILLS),
        behind_a_crest(partial(vehicles.slow_vehicle, size=(4.6, 2.3, 2.9), speed=3.2, curve=-1 / 130, traffic=False)),
    ),
    ("sweeper", (), partial(vehicles.slow_vehicle, size=vehicles.SWEEPER, speed=2.2, curve=0.0, traffic=False)),
    (
        "half_lane_truck",
        (ONCOMING, LEFT),
        in_mirror(
            partial(
                vehicles.standing_vehicle, label="heavy_truck", size=vehicles.TRUCK, offset=-1.2, turn=0.0, traffic=True
            )
        ),
    ),
    (
        "half_lane_truck_on_curve",
        (CURVED,),
        partial(
            vehicles.standing_vehicle,
            label="heavy_truck",
            size=vehicles.TRUCK,
            offset=-1.1,
            turn=0.03,
            traffic=False,
            curve=1 / 120,
        ),
    ),
    (
        "delivery_van",
        (ONCOMING,),
        partial(vehicles.standing_vehicle, label="heavy_truck", size=vehicles.VAN, offset=-0.5, turn=0.0, traffic=True),
    ),
    (
        "delivery_van_on_curve",
        (CURVED, ONCOMING),
        partial(
            vehicles.standing_vehicle,
            label="heavy_truck",
            size=vehicles.VAN,
            offset=-0.4,
            turn=0.0,
            traffic=True,
            curve=1 / 140,
        ),
    ),
    (
        "tow_truck_across",
        (),
        partial(
            vehicles.standing_vehicle, label="heavy_truck", size=(7.0, 2.4, 2.8), offset=-2.4, turn=1.2, traffic=False
        ),
    ),
    (
        "lost_trailer",
        (ONCOMING, HILLS),
        behind_a_crest(
            partial(
                vehicles.standing_vehicle, label="trailer", size=vehicles.TRAILER, offset=-0.2, turn=0.5, traffic=True
            )
        ),
    ),
    ("oversize_load", (ONCOMING, TAKEN), partial(vehicles.oversize_load, curve=0.0)),
    ("oversize_load_on_curve", (ONCOMING, TAKEN, CURVED), partial(vehicles.oversize_load, curve=-1 / 160)),
    ("backing_truck_right", (TAKEN,), partial(vehicles.backing_truck, side=1.0)),
    ("backing_truck_left", (TAKEN,), partial(vehicles.backing_truck, side=-1.0)),
    ("wrong_way_scooter", (TAKEN,), vehicles.wrong_way),
    ("bus_pulls_out", (ONCOMING, TAKEN), vehicles.bus_pulls_out),
    ("horse_carriage", (CURVED,), vehicles.horse_carriage),
    ("crossing_excavator", (TAKEN,), partial(vehicles.crossing_machine, side=1.0)),
)

_WORK_ZONES: tuple[Row, ...] = (
    ("lane_shift", (REASSIGNED, CONED, WEAK), partial(work_zones.lane_shift, curve=0.0)),
    ("lane_shift_on_curve", (REASSIGNED, CONED, WEAK, CURVED), partial(work_zones.lane_shift, curve=1 / 150)),
    ("one_lane_for_both", (GUIDED, REASSIGNED, CONED, ONCOMING), work_zones.one_lane),
    (
        "closed_lane",
        (REASSIGNED, CONED, ONCOMING, LEFT),
        in_mirror(partial(work_zones.closed_lane, traffic=True, curve=0.0)),
    ),
    ("worker_steps_out", (CONED, HILLS), behind_a_crest(work_zones.worker_steps_out)),
    ("taper_merge", (REASSIGNED, CONED), work_zones.taper_merge),
)

_BESIDE: dict[str, tuple[Row, ...]] = {
    "animal": (
        ("dog_runs", (), partial(extras.animals_cross, size=extras.DOG, count=1, speed=3.0)),
        ("herd_crosses", (), partial(extras.animals_cross, size=extras.COW, count=4, speed=1.2)),
    ),
    "debris": (
        ("lost_box", (), partial(extras.debris, size=(1.0, 0.9, 0.8), count=1, traffic=False)),
        ("lost_load", (ONCOMING,), partial(extras.debris, size=(2.2, 0.8, 0.5), count=3, traffic=True)),
    ),
    "cut_in": (
        ("cut_in_slow", (TAKEN,), partial(extras.cut_in, brakes=False)),
        ("cut_in_braking", (TAKEN,), partial(extras.cut_in, brakes=True)),
    ),
    "emergency_vehicle": (
        ("ambulance_crosses", (PRIORITY,), extras.ambulance_crosses),
        ("fire_engine_comes", (ONCOMING,), extras.fire_engine_comes),
    ),
    "nominal": (
        ("straight_road", (), partial(extras.nothing_ahead, curve=0.0)),
        ("curved_road", (CURVED,), partial(extras.nothing_ahead, curve=1 / 150)),
        ("free_crossroads", (), partial(extras.free_junction, goal=1, arms=4)),
        ("free_right_turn", (), partial(extras.free_junction, goal=0, arms=4)),
    ),
}


def _entries() -> dict[str, Entry]:
    groups = dict(zip(CATEGORIES, (_COMPLEX, _CYCLISTS, _VEHICLES, _WORK_ZONES), strict=True)) | _BESIDE
    return {
        name: Entry(name, category, factors, make) for category, rows in groups.items() for name, factors, make in rows
    }


EVENTS: Mapping[str, Entry] = _entries()
"""All events by name."""
LONGTAIL: tuple[str, ...] = tuple(name for name, entry in EVENTS.items() if entry.category in CATEGORIES)
"""The names of the 53."""


def find_event(name: str) -> Entry:
    """The event of a name.

    Raises:
        InputError: there is none.
    """
    if name not in EVENTS:
        raise InputError(f"event {name!r} is not one of {', '.join(EVENTS)}")
    return EVENTS[name]
