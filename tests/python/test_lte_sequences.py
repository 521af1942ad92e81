"""PSS, SSS, CRS and the resource grid against TS 36.211 written out in NumPy, and against another program's values."""

from pathlib import Path

import numpy as np
import pytest

from soopnav_cpp import lte

pytestmark = pytest.mark.crosscheck

VECTORS = Path(__file__).resolve().parents[2] / ".." / "shared" / "vectors" / "lte"
PREFIXES = (lte.CyclicPrefix.NORMAL, lte.CyclicPrefix.EXTENDED)
BANDWIDTHS = (6, 15, 25, 50, 75, 100)


def vectors(name: str) -> dict[str, np.ndarray]:
    path = VECTORS / name
    if not path.is_file():
        pytest.skip(f"the reference vectors ../shared/vectors/lte/{name} are not here")
    with np.load(path) as archive:
        return {key: archive[key] for key in archive.files}


def gold(c_init: np.ndarray, length: int) -> np.ndarray:
    """c(n) of section 7.2 for an array of initial values, shape (len(c_init), length)."""
    total = 1600 + length + 31
    x1 = np.zeros(total, np.uint8)
    x1[0] = 1
    x2 = np.zeros((len(c_init), total), np.uint8)
    x2[:, :31] = (c_init[:, None] >> np.arange(31)) & 1
    for n in range(total - 31):
        x1[n + 31] = x1[n + 3] ^ x1[n]
        x2[:, n + 31] = x2[:, n + 3] ^ x2[:, n + 2] ^ x2[:, n + 1] ^ x2[:, n]
    return x1[1600 : 1600 + length] ^ x2[:, 1600 : 1600 + length]


def test_pss_equals_the_formula() -> None:
    n = np.arange(62)
    for n_id_2, u in enumerate((25, 29, 34)):
        product = np.where(n <= 30, n * (n + 1), (n + 1) * (n + 2))
        np.testing.assert_allclose(lte.pss(n_id_2), np.exp(-1j * np.pi * u * product / 63), atol=5e-7)
        assert lte.pss(n_id_2).dtype == np.complex64


def m_sequence(taps: tuple[int, ...]) -> np.ndarray:
    x = [0, 0, 0, 0, 1]
    for i in range(26):
        x.append(sum(x[i + tap] for tap in taps) % 2)
    return 1 - 2 * np.array(x)


def test_sss_equals_the_definition_for_all_cells() -> None:
    s, c, z = m_sequence((2, 0)), m_sequence((3, 0)), m_sequence((4, 2, 1, 0))
    # Table 6.11.2.1-1: index pairs by growing distance.
    pairs = [(m0, m0 + distance) for distance in range(1, 8) for m0 in range(31 - distance)][:168]
    for cell in range(504):
        (m0, m1), n_id_2 = pairs[cell // 3], cell % 3
        c0, c1 = np.roll(c, -n_id_2), np.roll(c, -n_id_2 - 3)
        for subframe, (even, odd) in ((0, (m0, m1)), (5, (m1, m0))):
            expected = np.empty(62)
            expected[0::2] = np.roll(s, -even) * c0
            expected[1::2] = np.roll(s, -odd) * c1 * np.roll(z, -(even % 8))
            np.testing.assert_array_equal(lte.sss(cell, subframe), expected, err_msg=f"{cell}, subframe {subframe}")


def crs_place(cell: int, slot: int, symbol: int, port: int, n_rb: int) -> np.ndarray:
    """Section 6.10.1.2."""
    v = {0: 0 if symbol == 0 else 3, 1: 3 if symbol == 0 else 0, 2: 3 * (slot % 2), 3: 3 + 3 * (slot % 2)}[port]
    return 6 * np.arange(2 * n_rb) + (v + cell % 6) % 6


@pytest.mark.parametrize("cp", PREFIXES, ids=("normal", "extended"))
def test_crs_equal_the_definition_for_all_cells(cp: lte.CyclicPrefix) -> None:
    normal = cp == lte.CyclicPrefix.NORMAL
    cells = np.arange(504)
    for turn, symbol in enumerate((0, 1, 4 if normal else 3)):
        slots = (7 * cells + turn) % 20
        c_init = 1024 * (7 * (slots + 1) + symbol + 1) * (2 * cells + 1) + 2 * cells + (1 if normal else 0)
        bits = gold(c_init, 440).astype(int)
        r = ((1 - 2 * bits[:, 0::2]) + 1j * (1 - 2 * bits[:, 1::2])) / np.sqrt(2)
        for cell, slot in zip(cells.tolist(), slots.tolist(), strict=True):
            for n_rb in BANDWIDTHS if cell % 7 == 0 else (BANDWIDTHS[cell % 6],):
                for port in (2, 3) if symbol == 1 else (0, 1):
                    values, subcarriers = lte.crs(cell, slot, symbol, port=port, n_rb=n_rb, cp=cp)
                    np.testing.assert_allclose(values, r[cell, 110 - n_rb : 110 + n_rb], atol=1e-6)
                    np.testing.assert_array_equal(subcarriers, crs_place(cell, slot, symbol, port, n_rb))


@pytest.mark.parametrize(("name", "n_rb", "cp"), [("crs_nprb6_norm.npz", 6, 0), ("crs_nprb25_ext.npz", 25, 1)])
def test_crs_equal_the_reference_vectors(name: str, n_rb: int, cp: int) -> None:
    reference = vectors(name)
    for i, cell in enumerate(reference["cell_ids"].tolist()):
        for slot in range(20):
            for port in range(4):
                for j, symbol in enumerate(reference["l_p01" if port < 2 else "l_p23"].tolist()):
                    values, subcarriers = lte.crs(cell, slot, symbol, port=port, n_rb=n_rb, cp=PREFIXES[cp])
                    if port < 2:
                        expected, places = reference["crs_p01"][i, port, slot, j], reference["k_p01"][i, port, j]
                    else:
                        expected = reference["crs_p23"][i, port - 2, slot, j]
                        places = reference["k_p23"][i, port - 2, slot, j]
                    np.testing.assert_allclose(values, expected, atol=1e-6)
                    np.testing.assert_array_equal(subcarriers, places)


def test_resource_grid_equals_the_reference_vectors() -> None:
    """Everything that is no data, control or random: PSS, SSS, CRS of both ports and the PBCH of frames 100 to 105."""
    expected = vectors("grid_c101_p6.npz")["grid"]
    cell = lte.CellParameters(cell_id=101, n_rb=6, n_ports=2, sync_ports=lte.SyncPorts.ALL, data_load=0.0)
    compared = 0
    for i in range(60):
        ours = lte.resource_grid(cell, 100 + i // 10, i % 10)
        known = ours != 0
        compared += int(known.sum())
        # The reference's PSS is off by 2.3e-4: sine and cosine of large arguments in single precision.
        np.testing.assert_allclose(ours[known], expected[i][known], atol=5e-4)
        if i % 10 == 0:
            np.testing.assert_allclose(ours[:, 7:11], expected[i][:, 7:11], atol=1e-6)  # PBCH, its empty elements too
    assert compared == 6 * (2 * 2 * 2 * 62 + 2 * 240) + 60 * 2 * 48  # sync, PBCH, 48 CRS per port and subframe
