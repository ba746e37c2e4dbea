"""Camera contracts: which cameras a policy eats, by the name of the policy.

Plans of views, clips, exports, training and renderers go by these names. Cameras are told to a policy by their index
alone, so a contract is a set of cameras in the order of their indices (docs/formats/alpamayo.md).
"""

from collections.abc import Collection
from dataclasses import dataclass

from olt_generator.errors import InputError
from olt_toolkit.rigs.names import ContractName
from olt_toolkit.rigs.rig import CAMERA_INDEX, POLICY_CAMERAS, REAR_LEFT, REAR_RIGHT


@dataclass(frozen=True)
class CameraContract:
    """The cameras of one policy.

    Attributes:
        name: that of the policy, such as `alpamayo-r1`.
        cameras: names in the order of their indices.
    """

    name: str
    cameras: tuple[str, ...]

    @property
    def indices(self) -> tuple[int, ...]:
        """Index of each camera (`CAMERA_INDEX`), ascending."""
        return tuple(CAMERA_INDEX[camera] for camera in self.cameras)

    def lacking(self, views: Collection[str]) -> tuple[str, ...]:
        """The cameras that are not among the views."""
        return tuple(camera for camera in self.cameras if camera not in views)


def _contract(name: ContractName, cameras: tuple[str, ...]) -> CameraContract:
    return CameraContract(name.value, tuple(sorted(cameras, key=CAMERA_INDEX.__getitem__)))


CONTRACTS: dict[str, CameraContract] = {
    contract.name: contract
    for contract in (
        _contract(ContractName.ALPAMAYO_R1, POLICY_CAMERAS),
        _contract(ContractName.ALPAMAYO_1_5, POLICY_CAMERAS),
        _contract(ContractName.ALPAMAYO_2, (*POLICY_CAMERAS, REAR_LEFT, REAR_RIGHT)),
    )
}
DEFAULT_CONTRACT = CONTRACTS[ContractName.ALPAMAYO_R1]


def find_contract(name: str) -> CameraContract:
    """The contract of that name; an `InputError` where there is none."""
    if name not in CONTRACTS:
        raise InputError(f"no camera contract {name!r}; choose from {', '.join(CONTRACTS)}")
    return CONTRACTS[name]


def contracts_met(views: Collection[str]) -> tuple[CameraContract, ...]:
    """The contracts whose cameras are all among the views."""
    return tuple(contract for contract in CONTRACTS.values() if not contract.lacking(views))


def widest_contract(views: Collection[str]) -> CameraContract:
    """The first contract with the most cameras of those that the views meet; the default one where they meet none."""
    return max(contracts_met(views), key=lambda contract: len(contract.cameras), default=DEFAULT_CONTRACT)
