import pytest

from olt_generator.errors import InputError
from olt_toolkit.policy.window import Coverage, check_sample_window, sample_times
from olt_toolkit.rigs.contracts import CONTRACTS, DEFAULT_CONTRACT, contracts_met, find_contract, widest_contract
from olt_toolkit.rigs.names import ContractName
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE, REAR_LEFT, REAR_RIGHT
from olt_toolkit.rigs.rig_files import pav_rig


def test_contracts_are_those_of_alpamayo():
    """Indices of docs/formats/alpamayo.md."""
    assert {name: contract.indices for name, contract in CONTRACTS.items()} == {
        "alpamayo-r1": (0, 1, 2, 6),
        "alpamayo-1.5": (0, 1, 2, 6),
        "alpamayo-2": (0, 1, 2, 3, 5, 6),
    }
    assert DEFAULT_CONTRACT.name == "alpamayo-r1"
    assert [name.value for name in ContractName] == list(CONTRACTS)
    for contract in CONTRACTS.values():
        assert set(contract.cameras) <= set(pav_rig().cameras)


def test_what_views_meet_and_lack():
    two = find_contract("alpamayo-2")
    assert two.lacking(DEFAULT_CONTRACT.cameras) == (REAR_LEFT, REAR_RIGHT)
    assert [contract.name for contract in contracts_met(DEFAULT_CONTRACT.cameras)] == ["alpamayo-r1", "alpamayo-1.5"]
    assert [contract.name for contract in contracts_met(CAMERA_INDEX)] == list(CONTRACTS)
    assert contracts_met([FRONT_WIDE]) == ()
    assert widest_contract(CAMERA_INDEX) == two
    assert widest_contract([FRONT_WIDE]) == DEFAULT_CONTRACT


def test_unknown_contracts_are_refused():
    with pytest.raises(InputError, match="no camera contract 'alpamayo-3'; choose from alpamayo-r1, "):
        find_contract("alpamayo-3")


def test_samples_need_the_cameras_of_their_contract():
    two, span = find_contract("alpamayo-2"), (0, 20_000_000)
    four = Coverage(span, dict.fromkeys(DEFAULT_CONTRACT.cameras, span))
    assert sample_times(four)[0]
    times, reason = sample_times(four, two)
    assert times == ()
    assert f"no {REAR_LEFT}, {REAR_RIGHT}; a policy sample of alpamayo-2 needs" in reason
    with pytest.raises(InputError, match=f"clip: no {REAR_LEFT}"):
        check_sample_window(5_000_000, four, "clip", two)
    late = Coverage(span, four.cameras | {REAR_LEFT: (9_000_000, 20_000_000), REAR_RIGHT: span})
    assert sample_times(late, two)[0][0] == 9_300_000
    assert sample_times(late)[0][0] < 9_300_000
