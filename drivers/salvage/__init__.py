"""Recordings that were cut off or have a broken index: what is whole in them is read all the same."""

from drivers.salvage.bag import SalvagedBag, salvage

__all__ = ["SalvagedBag", "salvage"]
