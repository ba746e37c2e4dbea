"""Small invented scenarios in the formats of CommonRoad, OpenDRIVE, OpenSCENARIO, Waymo and NuRec.

All show a car that drives along x at 10 m/s, and another in the lane to its left.
"""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from olt_closed_loop.scenes.sources import waymo_motion
from olt_toolkit.recordings.messages import make_message_class
from olt_toolkit.recordings.tfrecord import masked_crc32c

SPEED, STEPS = 10.0, 60
TIMES = 0.1 * np.arange(STEPS)


def elements(name, *rows):
    return "".join(f"<{name}>{row}</{name}>" for row in rows)


def points(*rows):
    return elements("point", *(f"<x>{x}</x><y>{y}</y>" for x, y in rows))


def lanelet(name, low, high, start, end, inside):
    left, right = (points((start, y), (end, y)) for y in (high, low))
    return (
        f'<lanelet id="{name}"><leftBound>{left}<lineMarking>dashed</lineMarking></leftBound>'
        f"<rightBound>{right}<lineMarking>solid</lineMarking></rightBound>{inside}"
        "<laneletType>urban</laneletType></lanelet>"
    )


def obstacle(name, x, y, speed, kind="car", length=4.5, width=1.8):
    def state(tag, step):
        return (
            f"<{tag}><position>{points((x + speed * 0.1 * step, y))}</position><orientation><exact>0.0</exact>"
            f"</orientation><time><exact>{step}</exact></time></{tag}>"
        )

    states = "".join(state("state", step) for step in range(1, STEPS))
    return (
        f'<dynamicObstacle id="{name}"><type>{kind}</type><shape><rectangle><length>{length}</length>'
        f"<width>{width}</width></rectangle></shape>{state('initialState', 0)}<trajectory>{states}</trajectory>"
        "</dynamicObstacle>"
    )


def commonroad():
    """Two lanes in a row with a light between them, one beside them, two cars, one planning problem."""
    light = (
        '<trafficLight id="9"><cycle><cycleElement><duration>20</duration><color>red</color></cycleElement>'
        "<cycleElement><duration>30</duration><color>green</color></cycleElement><timeOffset>10</timeOffset></cycle>"
        "<direction>all</direction></trafficLight>"
    )
    first = '<successor ref="2"/><stopLine><trafficLightRef ref="9"/></stopLine><trafficLightRef ref="9"/>'
    return (
        '<?xml version="1.0"?><commonRoad commonRoadVersion="2020a" benchmarkID="ZAM_Test-1_1_T-1" timeStepSize="0.1">'
        + lanelet("1", -2.0, 2.0, -50.0, 30.0, first + '<adjacentLeft drivingDir="same" ref="3"/>')
        + lanelet("2", -2.0, 2.0, 30.0, 300.0, "")
        + lanelet("3", 2.0, 6.0, -50.0, 300.0, '<adjacentRight drivingDir="same" ref="1"/>')
        + light
        + obstacle("10", 0.0, 0.0, SPEED)
        + obstacle("11", 10.0, 4.0, 0.5 * SPEED, kind="truck", length=8.0, width=2.4)
        + '<planningProblem id="12"/></commonRoad>'
    )


def lane(number, kind="driving", width=4.0, links="", mark="broken"):
    return (
        f'<lane id="{number}" type="{kind}"><link>{links}</link><width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
        f'<roadMark sOffset="0" type="{mark}" laneChange="both"/></lane>'
    )


def road(name, geometry, length, link, left, right, junction="-1", rule="RHT"):
    return (
        f'<road id="{name}" length="{length}" junction="{junction}" rule="{rule}"><link>{link}</link>'
        f'<type s="0" type="town"><speed max="50" unit="km/h"/></type><planView>{geometry}</planView><lanes>'
        f'<laneSection s="0"><left>{left}</left><center><lane id="0" type="none"><roadMark sOffset="0" type="solid"/>'
        f"</lane></center><right>{right}</right></laneSection></lanes></road>"
    )


def geometry(x, y, heading, length, shape="<line/>", s=0.0):
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'


def opendrive(rule="RHT"):
    """A road along x of 400 m with two lanes on the right, which a junction continues straight on and to the left."""
    before = '<successor elementType="junction" elementId="7"/>'
    beyond = '<predecessor elementType="junction" elementId="7"/>'

    def through(name):
        linked = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
        return linked + f'<successor elementType="road" elementId="{name}" contactPoint="start"/>'

    both = '<predecessor id="-1"/><successor id="-1"/>'
    quarter = 0.5 * np.pi * 20.0
    roads = [
        road("1", geometry(-50, 0, 0, 400), 400, before, lane(1), lane(-1) + lane(-2, mark="solid"), rule=rule),
        road("2", geometry(380, 0, 0, 200), 200, beyond, "", lane(-1), rule=rule),
        road("3", geometry(370, 20, 0.5 * np.pi, 100), 100, beyond, "", lane(-1), rule=rule),
        road("4", geometry(350, 0, 0, 30), 30, through("2"), "", lane(-1, links=both), junction="7", rule=rule),
        road(
            "5",
            geometry(350, 0, 0, quarter, '<arc curvature="0.05"/>'),
            quarter,
            through("3"),
            "",
            lane(-1, links=both),
            junction="7",
            rule=rule,
        ),
    ]
    connections = "".join(
        f'<connection id="{number}" incomingRoad="1" connectingRoad="{name}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        for number, name in enumerate(("4", "5"))
    )
    junction = f'<junction id="7" name="">{connections}</junction>'
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6"/>{"".join(roads)}{junction}</OpenDRIVE>'


def vehicle(name, category="car"):
    return (
        f'<Vehicle name="{name}" vehicleCategory="{category}"><BoundingBox><Center x="1.4" y="0" z="0.75"/>'
        '<Dimensions width="1.8" length="4.5" height="1.5"/></BoundingBox><Axles>'
        '<FrontAxle positionX="2.8" trackWidth="1.6"/><RearAxle positionX="0" trackWidth="1.6"/></Axles></Vehicle>'
    )


def private(action):
    return f"<PrivateAction>{action}</PrivateAction>"


def teleport(position):
    return private(f"<TeleportAction><Position>{position}</Position></TeleportAction>")


def speed_action(target, shape="step", dimension="time", value="0"):
    dynamics = f'<SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}" value="{value}"/>'
    return private(
        f"<LongitudinalAction><SpeedAction>{dynamics}<SpeedActionTarget>{target}</SpeedActionTarget></SpeedAction>"
        "</LongitudinalAction>"
    )


def lane_change(lane_target, shape="sinusoidal", value="2"):
    dynamics = f'<LaneChangeActionDynamics dynamicsShape="{shape}" dynamicsDimension="time" value="{value}"/>'
    return private(
        f"<LateralAction><LaneChangeAction>{dynamics}<LaneChangeTarget>{lane_target}</LaneChangeTarget>"
        "</LaneChangeAction></LateralAction>"
    )


def trigger(condition, delay="0", edge="rising", tag="StartTrigger"):
    return (
        f'<{tag}><ConditionGroup><Condition name="one" delay="{delay}" conditionEdge="{edge}">{condition}</Condition>'
        f"</ConditionGroup></{tag}>"
    )


def after(seconds):
    return f'<ByValueCondition><SimulationTimeCondition value="{seconds}" rule="greaterThan"/></ByValueCondition>'


def by_entity(name, condition):
    return (
        f'<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="{name}"/>'
        f"</TriggeringEntities><EntityCondition>{condition}</EntityCondition></ByEntityCondition>"
    )


def event(name, action, start):
    return f'<Event name="{name}" priority="overwrite"><Action name="{name} action">{action}</Action>{start}</Event>'


CUT_IN = event("cut in", lane_change('<RelativeTargetLane entityRef="Ego" value="0"/>'), trigger(after("$When")))


def openscenario(events=CUT_IN, stop="8", init="", roads="roads.xodr", other="catalogue"):
    """The other drives in the right lane ahead of the ego, and changes into its lane after `When` seconds."""
    second = (
        '<CatalogReference catalogName="vehicles" entryName="car"/>' if other == "catalogue" else vehicle("car", other)
    )
    lane_position = '<LanePosition roadId="1" laneId="-1" s="50" offset="0"/>'
    beside = '<RelativeLanePosition entityRef="Ego" dLane="-1" ds="${10 + 2 * 5}" offset="0"/>'
    absolute, relative = (
        '<AbsoluteTargetSpeed value="$Speed"/>',
        '<RelativeTargetSpeed entityRef="Ego" value="0" speedTargetValueType="delta" continuous="false"/>',
    )
    group = (
        '<ManeuverGroup name="group" maximumExecutionCount="1"><Actors selectTriggeringEntities="false">'
        f'<EntityRef entityRef="Other"/></Actors><Maneuver name="maneuver">{events}</Maneuver></ManeuverGroup>'
    )
    act = f'<Act name="act">{group}{trigger(after("0"), edge="none")}</Act>'
    return (
        '<?xml version="1.0"?><OpenSCENARIO><FileHeader revMajor="1" revMinor="1"/><ParameterDeclarations>'
        f'<ParameterDeclaration name="Speed" parameterType="double" value="{SPEED}"/>'
        '<ParameterDeclaration name="When" parameterType="double" value="${$Speed / 5}"/></ParameterDeclarations>'
        '<CatalogLocations><VehicleCatalog><Directory path="catalogues"/></VehicleCatalog></CatalogLocations>'
        f'<RoadNetwork><LogicFile filepath="{roads}"/></RoadNetwork><Entities>'
        f'<ScenarioObject name="Ego">{vehicle("ego")}</ScenarioObject>'
        f'<ScenarioObject name="Other">{second}</ScenarioObject></Entities><Storyboard><Init><Actions>'
        f'<Private entityRef="Ego">{teleport(lane_position)}{speed_action(absolute)}</Private>'
        f'<Private entityRef="Other">{teleport(beside)}{speed_action(relative)}</Private>{init}</Actions></Init>'
        f'<Story name="story">{act}</Story>{trigger(after(stop), tag="StopTrigger")}</Storyboard></OpenSCENARIO>'
    )


def write_openscenario(folder, **changes):
    (folder / "catalogues").mkdir(parents=True, exist_ok=True)
    catalogue = f'<OpenSCENARIO><Catalog name="vehicles">{vehicle("car")}</Catalog></OpenSCENARIO>'
    (folder / "catalogues" / "vehicles.xosc").write_text(catalogue)
    (folder / "roads.xodr").write_text(opendrive())
    path = folder / "cut_in.xosc"
    path.write_text(openscenario(**changes))
    return path


SCENARIO = make_message_class("olt.waymo_test", waymo_motion._MESSAGES, "Scenario")


def waymo_scenario(name="abc"):
    """A scenario with the ego, a car beside it that is away for a second, a person of no time, two lanes, a light."""
    scenario = SCENARIO(scenario_id=name.encode(), sdc_track_index=1, timestamps_seconds=TIMES.tolist())
    for number, (kind, y, length) in enumerate(((1, 3.7, 4.5), (1, 0.0, 4.68), (2, 8.0, 0.6))):
        track = scenario.tracks.add(id=number, object_type=kind)
        for step, time in enumerate(TIMES):
            valid = kind == 1 and not (number == 0 and 20 <= step < 30)
            track.states.add(
                center_x=100.0 + SPEED * time, center_y=50.0 + y, length=length, width=1.9, height=1.5, valid=valid
            )
    for number, y in ((5, 0.0), (6, 3.7)):
        feature = scenario.map_features.add(id=number)
        feature.lane.type = 2
        feature.lane.speed_limit_mph = 25.0
        for x in np.arange(50.0, 400.0, 1.0):
            feature.lane.polyline.add(x=x, y=50.0 + y)
    scenario.map_features[-2].lane.left_neighbors.add(feature_id=6)
    scenario.map_features[-2].lane.left_boundaries.add(first=0, last=300, type=1)
    crossing = scenario.map_features.add(id=8)
    for x, y in ((200, 40), (200, 60), (204, 60), (204, 40)):
        crossing.crosswalk.polygon.add(x=x, y=y)
    for step in range(STEPS):
        scenario.dynamic_map_states.add().lane_states.add(lane=5, state=4 if step < 20 else 6)
    return scenario


def write_records(path, *records):
    with Path(path).open("wb") as file:
        for record in records:
            length = struct.pack("<Q", len(record))
            file.write(length + struct.pack("<I", masked_crc32c(length)) + record)
            file.write(struct.pack("<I", masked_crc32c(record)))
    return Path(path)


def write_waymo(path, *names):
    return write_records(path, *(waymo_scenario(name).SerializeToString() for name in names or ("abc",)))


def parquet_bytes(rows):
    file = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(rows), file)
    return file.getvalue()


def nurec_lanes():
    def rail(y, first, last):
        return [{"x": x, "y": y, "z": 0.0} for x in np.linspace(first, last, 20).tolist()]

    return [
        {
            "key": {"clip_id": "c", "map_id": name},
            "lane": {"left_rail": rail(2.0, *span), "right_rail": rail(-2.0, *span)},
            "version": 1,
        }
        for name, span in (("1", (-50.0, 30.0)), ("2", (30.0, 300.0)))
    ]


def nurec_members():
    """The members of an archive: an ego that drives along x, a car beside it, two lanes and a stop line."""
    times = (10**9 + 100_000 * np.arange(STEPS)).tolist()
    poses = np.tile(np.eye(4), (STEPS, 1, 1))
    poses[:, 0, 3] = SPEED * TIMES
    tracks = [[x + 12.0, 4.0, 0.75, 0.0, 0.0, 0.0, 1.0] for x in poses[:, 0, 3].tolist()]
    rigs = {
        "world_to_nre": {"matrix": np.eye(4).tolist()},
        "T_world_base": np.eye(4).tolist(),
        "camera_calibrations": {},
        "rig_trajectories": [
            {
                "sequence_id": "s",
                "T_rig_world_timestamps_us": times,
                "T_rig_worlds": poses.tolist(),
                "cameras_frame_timestamps_us": {},
                "rig_bbox": {"centroid": [1.4, 0.0, 0.75], "dim": [4.8, 2.0, 1.5], "rot": [0.0, 0.0, 0.0]},
            }
        ],
    }
    sequence = {
        "dummy_chunk_id": {
            "tracks_data": {
                "tracks_id": ["7"],
                "tracks_label_class": ["automobile"],
                "tracks_flags": [["DYNAMIC", "CONTROLLABLE"]],
                "tracks_timestamps_us": [times],
                "tracks_poses": [tracks],
            },
            "cuboidtracks_data": {"cuboids_dims": [[4.5, 1.8, 1.5]]},
        }
    }
    line = [{"x": 30.0, "y": y, "z": 0.0} for y in (2.0, -2.0)]
    wait = [{"key": {"map_id": "4-1"}, "wait_line": {"location": line, "category": "STOP"}, "version": 1}]
    return {
        "metadata.yaml": b"scene_id: clipgt-test\nversion_string: '26.04'\n",
        "rig_trajectories.json": json.dumps(rigs).encode(),
        "sequence_tracks.json": json.dumps(sequence).encode(),
        "clipgt/lane.parquet": parquet_bytes(nurec_lanes()),
        "clipgt/wait_line.parquet": parquet_bytes(wait),
        "default.usda": b"#usda 1.0\n",
    }


def write_nurec(path, members=None, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in (members or nurec_members()).items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return Path(path)


def write_all(folder):
    """One file of each format, by its ending."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "one.xml").write_text(commonroad())
    write_openscenario(folder)
    write_waymo(folder / "one.tfrecord")
    write_nurec(folder / "one.usdz")
    names = ("one.xml", "roads.xodr", "cut_in.xosc", "one.tfrecord", "one.usdz")
    return {name.rpartition(".")[2]: folder / name for name in names}
