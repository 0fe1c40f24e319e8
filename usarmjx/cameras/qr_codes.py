"""QR codes as signs: version 1 of ISO/IEC 18004, 21 x 21 cells, with its highest error correction."""

import numpy as np

QR_SIDE = 21
"""Cells along a side."""
QR_RIM = 4
"""White cells around it, as the standard asks for."""
QR_HEX = (
    "1fd97f822a0dd1d76eaebb7425d82320ff55fc000005d889150d5fdf565c64defdc9b00c167f2b4a0b3cd75a4bba0b35d6716098a7fc861",
    "1fd27f82ca0dd0576ea4bb75e5d82aa0ff55fc00c0024d3b5c33595682f848cc67d5b009977f136e08fcd74899bad37dd051609803fca28",
    "1fde7f82420dd3576eaebb7445d822a0ff55fc012005d989119359bf46527c5fb445b00af67f33ca0b0cd7534bba2b35d5e16099a7fc8e1",
    "1fd57f82a20dd2d76ea4bb7585d82b20ff55fc01e0024c3b58ad5f3692f6504d2e59b00f777f0bee08ccd74199baf37dd3c1609903fcaa8",
    "1fca7f828a0dd5976eaabb75b5d82b20ff55fc004004f8bec9560f137ccd790aa72f100e637f63a20bb9974e61ba1a65d79be09573fca8b",
    "1fdb7f821a0dd2176eb4bb7495d826a0ff55fc014005d589d53d5979267524de9799b00cfe7f380a0b2cd7528bba0535d7116089a7fc021",
    "1fc37f82ea0dd3576e96bb7435d82a20ff55fc02a001e7622c46367f1d047dfbd640900860ff7c3e0a4e975959ba345dd07a208803fc433",
    "1fc87f82aa0dd2576e9cbb74b5d82aa0ff55fc02e001e062657832bfed29757b4c5c900fa8ff4d3e0b8e975f19ba7e5dd25a208183fc433",
    "1fd57f82b20dd0176ea2bb7575d829a0ff55fc0000024f3bf98f5c35b2fd30cc95c5b00cdf7f316e0908d74319bafb7dd151609c83fce28",
    "1fca7f828a0dd3576e80bb74f5d82da0ff55fc024001ee62046a371abd0b55fa9d90900ce8ff64fe0a5a975559ba785dd1aa209503fc8f3",
)
"""The cells of the codes that say USARMJX 0 to USARMJX 9, row by row from the top left, dark as 1."""


def qr_cells() -> np.ndarray:
    """Return which cells are dark (codes, 21, 21), bool."""
    rows = [f"{int(digits, 16):0{QR_SIDE**2}b}" for digits in QR_HEX]
    return np.array([[bit == "1" for bit in row] for row in rows]).reshape(-1, QR_SIDE, QR_SIDE)


QR_CELLS = qr_cells()
