use nalgebra::dmatrix;
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::{Continuous, Discrete, SampleTime};

fn random(rng: &mut rand_pcg::Pcg64, n_x: usize, n_y: usize, n_u: usize) -> StateSpace<Continuous> {
    let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
    let (a, b, c, d) = (m(n_x, n_x), m(n_x, n_u), m(n_y, n_x), m(n_y, n_u));
    StateSpace::<Continuous>::new(a, b, c, d * 0.2).expect("shapes fit")
}

fn assert_close(found: &StateSpace<Continuous>, expected: &DMatrix<Complex64>, omega: f64) {
    let found = found.at(omega).expect("no pole");
    assert!((&found - expected).norm() < 1e-11 * (1.0 + expected.norm()), "{found} against {expected}");
}

#[test]
fn law_names_and_algebra_give_one_loop() {
    let seed = 41;
    let rng = &mut rand_pcg::Pcg64::seed_from_u64(seed);
    for _ in 0..20 {
        let (g, k) = (random(rng, 4, 2, 3), random(rng, 3, 3, 2));
        let closed = Diagram::new()
            .external_inputs([("r", 2), ("d", 3)])
            .sum("e = r - y")
            .sum("v = u + d")
            .block(&k, ["e"], ["u"])
            .block(&g, ["v"], ["y"])
            .external_outputs(["y", "u", "e[1]"])
            .connect()
            .expect("well posed");
        assert_eq!(closed.sys().n_states(), 7);
        let series = k.series(&g).expect("fits");
        let unity = StateSpace::<Continuous>::from_gain(DMatrix::identity(2, 2)).expect("valid");
        let t = series.feedback(&unity).expect("well posed");
        let ks = k.feedback(&g).expect("well posed");
        let gs = g.feedback(&k).expect("well posed");
        for omega in [0.0, 0.8, 20.0] {
            let at = |sys: &StateSpace<Continuous>| sys.at(omega).expect("no pole");
            assert_close(&closed.from_to(&["r"], &["y"]).expect("named"), &at(&t), omega);
            assert_close(&closed.from_to(&["r"], &["u"]).expect("named"), &at(&ks), omega);
            assert_close(&closed.from_to(&["d"], &["y"]).expect("named"), &at(&gs), omega);
            let s = DMatrix::identity(2, 2) - at(&t);
            let e1 = closed.from_to(&["r"], &["e[1]"]).expect("named");
            assert_close(&e1, &s.rows(1, 1).into_owned(), omega);
        }
    }
}

#[test]
fn law_parts_of_signals_go_where_they_are_sent() {
    // Two scalar channels crossed over: y = [2 u1; 3 u0].
    let double = StateSpace::<Continuous>::from_gain(dmatrix![2.0]).expect("valid");
    let triple = StateSpace::<Continuous>::from_gain(dmatrix![3.0]).expect("valid");
    let crossed = Diagram::new()
        .external_inputs([("u", 3)])
        .block(&double, ["u[1]"], ["a"])
        .block(&triple, ["u[0]"], ["b"])
        .sum("s = 0.5*a - u[2] + 4*b")
        .external_outputs(["a", "b", "s", "u[1..3]"])
        .connect()
        .expect("no loop");
    let expected = dmatrix![
        0.0, 2.0, 0.0; 3.0, 0.0, 0.0; 12.0, 1.0, -1.0; 0.0, 1.0, 0.0; 0.0, 0.0, 1.0];
    assert_eq!(*crossed.sys().d(), expected);
    let names: Vec<_> = crossed.outputs().iter().map(|s| (s.name(), s.width())).collect();
    assert_eq!(names, [("a", Some(1)), ("b", Some(1)), ("s", Some(1)), ("u[1..3]", Some(2))]);
}

#[test]
fn law_sums_may_stand_in_any_order_and_refer_to_each_other() {
    let unit = StateSpace::<Continuous>::from_gain(dmatrix![1.0]).expect("valid");
    let sys = Diagram::new()
        .sum("c = b + a")
        .sum("b = a - 3*r")
        .sum("a = r + y")
        .external_inputs(["r"])
        .block(&unit, ["r"], ["y"])
        .external_outputs(["c"])
        .connect()
        .expect("no loop");
    // a = 2 r, b = -r, c = r.
    assert_eq!(sys.sys().d()[(0, 0)], 1.0);
}

#[test]
fn law_a_result_can_be_a_block_of_the_next_diagram() {
    let ts = SampleTime::new(0.1).expect("positive");
    let lag = StateSpace::<Discrete>::new(dmatrix![0.5], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], ts)
        .expect("valid");
    let inner = Diagram::new()
        .external_inputs(["v"])
        .sum("e = v - y")
        .block(&lag, ["e"], ["y"])
        .external_outputs(["y"])
        .connect()
        .expect("well posed");
    let outer = Diagram::new()
        .external_inputs(["r"])
        .sum("v = 3*r")
        .named_block(&inner)
        .external_outputs(["y"])
        .connect()
        .expect("well posed");
    assert_eq!(outer.sys().sample_time(), ts);
    // x+ = 0.5 x + 3 r - x: pole -0.5, gain 3 / 1.5.
    assert!((outer.sys().a()[(0, 0)] + 0.5).abs() < 1e-15);
    assert!((outer.sys().dc_gain().expect("stable")[(0, 0)] - 2.0).abs() < 1e-15);
}

#[test]
fn edge_an_algebraic_loop_names_its_signals_and_no_others() {
    let gain = |k: f64| StateSpace::<Continuous>::from_gain(dmatrix![k]).expect("valid");
    let (k, g, other) = (gain(2.0), gain(-0.5), gain(7.0));
    let diagram = Diagram::new()
        .external_inputs(["r"])
        .block(&other, ["r"], ["x"])
        .sum("e = r - y")
        .block(&k, ["e"], ["u"])
        .block(&g, ["u"], ["y"])
        .external_outputs(["y", "x"]);
    match diagram.connect() {
        Err(Error::SignalLoop { signals, .. }) => assert_eq!(signals, ["u", "y", "e"]),
        other => panic!("expected a loop, found {other:?}"),
    }
    let sums = Diagram::new()
        .external_inputs(["r"])
        .block(&k, ["r"], ["y"])
        .sum("a = b")
        .sum("b = a")
        .external_outputs(["y", "a"])
        .connect();
    assert!(matches!(sums, Err(Error::SignalLoop { signals, .. }) if signals == ["a", "b"]));
}

#[test]
fn edge_names_that_do_not_fit_are_named() {
    let one = StateSpace::<Continuous>::from_gain(dmatrix![1.0]).expect("valid");
    let two = StateSpace::<Continuous>::from_gain(DMatrix::identity(2, 2)).expect("valid");
    let base = || Diagram::new().external_inputs(["r"]).external_outputs(["y"]);
    let unknown = base().block(&one, ["q"], ["y"]).connect();
    assert!(matches!(unknown, Err(Error::UnknownSignal { signal, .. }) if signal == "q"));
    let duplicate = base().block(&one, ["r"], ["y"]).block(&one, ["r"], ["y"]).connect();
    assert!(matches!(duplicate, Err(Error::DuplicateSignal { signal }) if signal == "y"));
    let duplicate = base().block(&one, ["r"], ["y"]).sum("r = y").connect();
    assert!(matches!(duplicate, Err(Error::DuplicateSignal { signal }) if signal == "r"));
    let idle = base().block(&one, ["r"], ["y"]).block(&one, ["r"], ["x"]);
    let refused = idle.connect();
    assert!(matches!(refused, Err(Error::UnconnectedSignal { signal }) if signal == "x"));
    assert!(idle.leave_open(["x"]).connect().is_ok());
    let wide = base().block(&two, ["r"], ["y"]).connect();
    assert!(matches!(wide, Err(Error::SignalWidth { expected: 2, found: 1, .. })));
    let narrow = base().block(&two, ["r", "r"], ["y", "x", "z"]).connect();
    assert!(matches!(narrow, Err(Error::SignalWidth { expected: 2, found: 3, .. })));
    let index = base().block(&one, ["r[1]"], ["y"]).connect();
    assert!(matches!(index, Err(Error::SignalIndex { index: 1, width: 1, .. })));
    let sum = base().block(&two, ["r", "r"], [("y", 2)]).sum("e = y - r").leave_open(["e"]).connect();
    assert!(matches!(sum, Err(Error::SignalWidth { expected: 2, found: 1, .. })));
    let sum = base().block(&one, ["r"], ["y"]).sum("e = nothing").leave_open(["e"]).connect();
    assert!(matches!(sum, Err(Error::UnknownSignal { signal, .. }) if signal == "nothing"));
    let empty = Diagram::<Continuous>::new().external_inputs(["r"]).external_outputs(["r"]).connect();
    assert_eq!(empty, Err(Error::NoBlocks));
    let blind = Diagram::new().external_inputs(["r"]).block(&one, ["r"], ["y"]).leave_open(["y"]).connect();
    assert!(matches!(blind, Err(Error::NoPorts { .. })));
    let named = base().block(&one, ["r"], ["y z"]).connect();
    assert!(matches!(named, Err(Error::SignalName { .. })));
    let open = base().block(&one, ["r"], ["y"]).leave_open(["w"]).connect();
    assert!(matches!(open, Err(Error::UnknownSignal { signal, .. }) if signal == "w"));
    let zero = base().external_inputs([("d", 0)]).block(&one, ["r"], ["y"]).connect();
    assert!(matches!(zero, Err(Error::SignalWidth { found: 0, .. })));
}
