from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam.output.g2o import graph_text
from mfslam.output.graph_reader import InformationOrder, read_graph
from mfslam.types import Edge, MfslamError

HEAD = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
TOKENS = [
    "VERTEX_SE2",
    "EDGE_SE2",
    "EDGE2",
    "FIX",
    "\n",
    "0",
    "1",
    "2",
    "1e9",
    "-1",
    "nan",
    "1 0 0 1 0 1",
    "1 0 0",
    "#",
]
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
    graph = read_graph(path)
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
    graph = read_graph(path)
    np.testing.assert_array_equal(graph.i, graph.j)
    assert graph.information[1, 2, 2] == 50.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0", r":3: expected 'EDGE_SE2 i j x y theta, .* got 10 fields"),
        (HEAD + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1 5", r":3: expected .* got 12 fields"),
        (HEAD + "EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1", r":3: vertex 7 is nowhere in the file"),
        (HEAD + "EDGE_SE2 1 1 1 0 0 1 0 0 1 0 1", r":3: an edge from vertex 1 to itself"),
        (HEAD + "FIX 9", r":3: vertex 9 is nowhere"),
        (HEAD + "VERTEX_SE2 1 0 0 0", r":3: vertex 1 was already given on line 2"),
        (HEAD + "EDGE_SE2 0 1 1 0 nan 1 0 0 1 0 1", r":3: expected finite numbers"),
        (HEAD + "EDGE_SE2 0 1 1 0 1e400 1 0 0 1 0 1", r":3: expected finite numbers"),
        (HEAD + "EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1", r":3: expected a whole number as id, got '1.5'"),
        (HEAD + f"VERTEX_SE2 {2**63} 0 0 0", r":3: expected an id of at most 63 bits"),
        (HEAD + "EDGE_SE2 0 1 1 0 zero 1 0 0 1 0 1", r":3: expected .* no number"),
        (HEAD + "EDGE_SE2 0 1 1_0 0 0 1 0 0 1 0 1", r":3: expected .* no number"),
        (HEAD + "EDGE_SE2 0 1 1 0 0 1 9 9 1 0 1", r":3: the information matrix has a negative eigenvalue"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", r":1: VERTEX_SE3:QUAT: this is a graph in three dimensions"),
        ("VERTEX_XY 0 0 0", r":1: VERTEX_XY: landmarks are not read"),
        ("hello", r":1: hello: expected one of FIX, VERTEX_SE2"),
        ("# nothing", r"holds no pose"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.g2o"
    path.write_text(text + "\n")
    with pytest.raises(MfslamError, match=message):
        read_graph(path)


@given(st.text(max_size=200) | st.lists(st.sampled_from(TOKENS), max_size=30).map(" ".join))
def test_any_text_is_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.g2o"
    path.write_text(HEAD + text, encoding="utf-8", errors="replace")
    try:
        graph = read_graph(path)
    except MfslamError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(graph.world_T_pose).all()
        assert np.isfinite(graph.information).all()
        assert set(graph.i.tolist()) | set(graph.j.tolist()) | graph.fixed <= set(graph.ids.tolist())


FULL = np.array([[400.0, 30.0, 5.0], [30.0, 900.0, -7.0], [5.0, -7.0, 2500.0]])
G2O_SIX, TORO_SIX = "400 30 5 900 -7 2500", "400 30 900 2500 5 -7"


@pytest.mark.parametrize(
    ("tag", "six", "order"),
    [
        ("EDGE_SE2", G2O_SIX, None),
        ("EDGE2", TORO_SIX, None),
        ("EDGE_SE2", TORO_SIX, "toro"),
        ("EDGE2", G2O_SIX, "g2o"),
        ("EDGE_SE2", "44 0 44 16 0 0", None),  # only TORO's order is a covariance's inverse
    ],
)
def test_orders_of_information_are_told_apart(
    tmp_path: Path, tag: str, six: str, order: InformationOrder | None
) -> None:
    path = tmp_path / "g.graph"
    path.write_text(f"{HEAD}{tag} 0 1 1 0 0 {six}\n")
    graph = read_graph(path, order)
    expected = np.diag([44.0, 44.0, 16.0]) if six.startswith("44 ") else FULL
    np.testing.assert_array_equal(graph.information[0], expected)
    assert bool(graph.notes) == six.startswith("44 ")


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    path = tmp_path / "g.graph"
    path.write_text(HEAD + "EQUIV 0 1\n")
    assert read_graph(path).notes == (
        "1 EQUIV lines (two names of one pose) are left out, as other optimisers do",
    )


@pytest.mark.parametrize(
    ("name", "vertices", "edges"),
    [("intel.g2o", 943, 1837), ("M3500.g2o", 3500, 5453), ("city10000.g2o", 10000, 20687)],
)
def test_standard_graphs_read(shared_data: Path, name: str, vertices: int, edges: int) -> None:
    graph = read_graph(shared_data / "pose_graphs" / name)
    assert (len(graph.ids), len(graph.i)) == (vertices, edges)


def test_toro_order_is_known_by_tag_and_without(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "pose_graphs" / "M3500b_toro_order.g2o"
    mistagged = tmp_path / "toro.g2o"
    mistagged.write_text(path.read_text().replace("VERTEX2", "VERTEX_SE2").replace("EDGE2", "EDGE_SE2"))
    by_tag, by_value = read_graph(path), read_graph(mistagged)
    np.testing.assert_array_equal(by_tag.information, by_value.information)
    assert by_tag.information[0].tolist() == np.diag([44.721360, 44.721360, 16.035746]).tolist()
    assert "unlike what their tags say" in by_value.notes[0]


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
