"""How many items each component gives to every epoch, so that shares are exact over epochs and not in each alone.

An epoch e of n items owes component c exactly n s_c(e) items. Their whole part it gets at once. The fractions f_c(e)
that are left sum to a whole number m(e) of items, which are given in m(e) turns; each owes c another f_c(e) / m(e).
With F_c what is owed so far in fractions and G_c what was given for them, a turn's item goes to a component with
F_c > G_c, and among these to the one whose F_c reaches G_c + 1 first: the earliest deadline. It follows that
|F_c - G_c| < 1 after every turn (R. Tijdeman, "The chairman assignment problem", Discrete Mathematics 32, 1980, shows
that such an order exists; that the earliest deadline finds it is the usual exchange of two items). So

- over epochs 0 to E, for any E, a component gives its exact items rounded down or up;
- an epoch gives each component no less than its exact items rounded down, no more than these rounded up and one, and
  with two components these rounded down or up;
- an epoch holds n items.

A component whose share falls to 0 may still get the one item that it is owed.
"""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction

from olt_generator.errors import InputError

LONGEST_PLAN = 20_000
"""Epochs that a plan without a short period reaches to."""

Shares = Callable[[int], Sequence[Fraction]]


class EpochPlan:
    """The items of every component in every epoch.

    Fixed shares repeat after as many epochs as their exact items have for a common denominator, and a curriculum
    some time after its end; a plan is built as far as it is asked for, and that far once.

    Args:
        shares: the shares of an epoch, which sum to 1; those of `last` hold from there on.
        last: see there; 0 for shares that never change.
        samples: items of an epoch.
    """

    def __init__(self, shares: Shares, last: int, samples: int) -> None:
        self._shares, self._last, self._samples = shares, last, samples
        self._final = self._fractions(last)
        self._period = math.lcm(*(fraction.denominator for fraction in self._final))
        # What the fractions of epochs 0 to e - 1 owe, and what was given for them, at place e.
        self._owed = [[Fraction(0)] * len(self._final)]
        self._given = [[0] * len(self._final)]
        self._deadlines: dict[tuple[int, int], Fraction | float] = {}

    def counts(self, epoch: int) -> list[int]:
        """Items of each component in an epoch; InputError for one too late to be told in seconds."""
        epoch = self._fold(epoch)
        if epoch > LONGEST_PLAN:
            raise InputError(f"epoch {epoch}: with these shares and samples, plans go to epoch {LONGEST_PLAN}")
        self._extend(epoch + 1)
        before, after = self._given[epoch : epoch + 2]
        whole = (math.floor(self._samples * share) for share in self._shares(epoch))
        return [items + given - had for items, given, had in zip(whole, after, before, strict=True)]

    def _fold(self, epoch: int) -> int:
        """An early epoch with the same counts."""
        start = self._last
        while start + self._period <= min(epoch, LONGEST_PLAN):
            self._extend(start + self._period)
            if self._lags(start) == self._lags(start + self._period):
                return start + (epoch - start) % self._period
            start += self._period
        return epoch

    def _lags(self, epoch: int) -> list[Fraction]:
        return [owed - given for owed, given in zip(self._owed[epoch], self._given[epoch], strict=True)]

    def _fractions(self, epoch: int) -> list[Fraction]:
        return [self._samples * share % 1 for share in self._shares(epoch)]

    def _extend(self, epochs: int) -> None:
        while len(self._given) <= epochs:
            epoch, given = len(self._given) - 1, list(self._given[-1])
            fractions = self._fractions(epoch)
            turns = int(sum(fractions))
            for turn in range(1, turns + 1):
                open_ones = [
                    place
                    for place, (before, part) in enumerate(zip(self._owed[epoch], fractions, strict=True))
                    if before + part * turn / turns > given[place]
                ]
                given[min(open_ones, key=lambda place: self._deadline(place, given[place] + 1))] += 1
            self._given.append(given)
            self._owe(epoch + 1)

    def _deadline(self, place: int, items: int) -> Fraction | float:
        """When, in epochs from the start, a component is owed so many items for its fractions."""
        if (place, items) not in self._deadlines:
            self._deadlines[place, items] = self._find_deadline(place, items)
        return self._deadlines[place, items]

    def _find_deadline(self, place: int, items: int) -> Fraction | float:
        epoch = len(self._given) - 1
        while epoch < self._last:
            self._owe(epoch + 1)
            before, after = self._owed[epoch][place], self._owed[epoch + 1][place]
            if after >= items:
                return epoch + (items - before) / (after - before)
            epoch += 1
        self._owe(epoch)
        rate = self._final[place]
        return epoch + (items - self._owed[epoch][place]) / rate if rate else math.inf

    def _owe(self, epochs: int) -> None:
        """Sum the fractions of so many epochs."""
        while len(self._owed) <= epochs:
            fractions = self._fractions(len(self._owed) - 1)
            self._owed.append([owed + part for owed, part in zip(self._owed[-1], fractions, strict=True)])
