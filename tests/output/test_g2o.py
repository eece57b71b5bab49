from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam.output.g2o import graph_text, read_g2o
from mfslam.types import Edge, MfslamError

HEAD = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
numbers = st.floats(-1e6, 1e6)
vectors = st.tuples(numbers, numbers, numbers)


@given(st.lists(st.tuples(vectors, st.lists(vectors, min_size=3, max_size=3)), min_size=1, max_size=8))
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[list[float], list[list[float]]]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "round.g2o"
    poses = np.array([row[0] for row in rows])
    edges = []
    for n, (pose, root) in enumerate(rows):
        r = np.array(root)
        edges.append(Edge("scan", n, (n + 1) % len(rows), np.array(pose), r.T @ r))
    path.write_text(graph_text(poses, edges))
    graph = read_g2o(path)
    np.testing.assert_array_equal(graph.world_T_pose, poses)
    np.testing.assert_array_equal(graph.i_T_j, poses)
    np.testing.assert_array_equal(
        graph.information, [np.triu(e.information) + np.triu(e.information, 1).T for e in edges]
    )
    np.testing.assert_array_equal(graph.j, [e.j for e in edges])


def test_factors_on_one_pose_are_priors(tmp_path: Path) -> None:
    edges = [
        Edge("prior", 0, 0, np.zeros(3), np.eye(3)),
        Edge("heading", 1, 1, np.array([0.0, 0.0, 0.3]), np.diag([0.0, 0.0, 50.0])),
    ]
    path = tmp_path / "g.g2o"
    path.write_text(graph_text(np.zeros((2, 3)), edges))
    assert path.read_text().count("EDGE_PRIOR_SE2 ") == 2
    assert "FIX" not in path.read_text()
    graph = read_g2o(path)
    np.testing.assert_array_equal(graph.i, graph.j)
    assert graph.information[1, 2, 2] == 50.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0", r":3: expected 'EDGE_SE2 i j x y theta I11 .* got 10 fields"),
        (HEAD + "EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1", r":3: vertex 7 is nowhere in the file"),
        (HEAD + "FIX 9", r":3: vertex 9 is nowhere"),
        (HEAD + "VERTEX_SE2 1 0 0 0", r":3: vertex 1 was already given on line 2"),
        (HEAD + "EDGE_SE2 0 1 1 0 nan 1 0 0 1 0 1", r":3: expected finite numbers"),
        (HEAD + "EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1", r":3: expected a whole number as id, got '1.5'"),
        (HEAD + "EDGE_SE2 0 1 1 0 zero 1 0 0 1 0 1", r":3: expected .* no number"),
        (HEAD + "EDGE_SE2 0 1 1 0 0 44 0 44 16 0 0", r":3: the information matrix has a negative .* TORO"),
        ("VERTEX2 0 0 0 0", r":1: VERTEX2: expected one of FIX, VERTEX_SE2"),
        ("# nothing", r"holds no pose"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.g2o"
    path.write_text(text + "\n")
    with pytest.raises(MfslamError, match=message):
        read_g2o(path)


@pytest.mark.parametrize(
    ("name", "vertices", "edges"),
    [("intel.g2o", 943, 1837), ("M3500.g2o", 3500, 5453), ("city10000.g2o", 10000, 20687)],
)
def test_standard_graphs_read(shared_data: Path, name: str, vertices: int, edges: int) -> None:
    graph = read_g2o(shared_data / "pose_graphs" / name)
    assert (len(graph.ids), len(graph.i)) == (vertices, edges)


def test_toro_order_under_g2o_tags_is_refused(shared_data: Path, tmp_path: Path) -> None:
    text = (shared_data / "pose_graphs" / "M3500b_toro_order.g2o").read_text()
    path = tmp_path / "toro.g2o"
    path.write_text(text.replace("VERTEX2", "VERTEX_SE2").replace("EDGE2", "EDGE_SE2"))
    with pytest.raises(MfslamError, match=r"TORO's order I11 I12 I22 I33 I13 I23"):
        read_g2o(path)


def test_gtsam_reads_the_same_graph(tmp_path: Path) -> None:
    gtsam = pytest.importorskip("gtsam")
    information = np.array([[400.0, 30.0, 5.0], [30.0, 900.0, -7.0], [5.0, -7.0, 2500.0]])
    edge = Edge("loop", 0, 1, np.array([1.0, 0.2, 0.1]), information)
    rejected = Edge("loop", 0, 1, np.array([9.0, 9.0, 0.1]), information, weight=0.0)
    path = tmp_path / "g.g2o"
    path.write_text(graph_text(np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.2]]), [rejected, edge]))
    factors, values = gtsam.readG2o(str(path))
    assert factors.size() == 1
    assert values.atPose2(1).theta() == 0.2
    np.testing.assert_allclose(factors.at(0).noiseModel().information(), information, rtol=1e-9)
