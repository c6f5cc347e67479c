//! Control nodes.

use super::*;

#[test]
fn a_sequence_continues_with_the_running_child() {
    let mut stage = TreeFixture::from_root(sequence([play("a", "S"), play("b", "RRS"), play("c", "S")]));
    stage.expect(&[('R', "a b"), ('R', "b"), ('S', "b c")]);
}

#[test]
fn a_sequence_ends_with_the_first_failure_and_restarts() {
    let mut stage = TreeFixture::from_root(sequence([play("a", "S"), play("b", "FS"), play("c", "S")]));
    stage.expect(&[('F', "a b"), ('S', "a b c")]);
}

#[test]
fn a_halted_sequence_halts_the_child_that_runs_and_no_other() {
    let mut stage = TreeFixture::from_root(sequence([play("a", "S"), play("b", "R"), play("c", "S")]));
    stage.expect(&[('R', "a b")]);
    assert_eq!(stage.halt(), "b!");
    assert_eq!(stage.halt(), "", "nothing runs any more");
    stage.expect(&[('R', "a b")]);
}

#[test]
fn a_fallback_ends_with_the_first_success() {
    let mut stage = TreeFixture::from_root(fallback([play("a", "F"), play("b", "RS"), play("c", "S")]));
    stage.expect(&[('R', "a b"), ('S', "b"), ('S', "a b")]);
}

#[test]
fn a_fallback_fails_when_all_do_with_the_last_cause() {
    let mut stage = TreeFixture::from_root(fallback([play("a", "F"), play("b", "F")]));
    stage.expect(&[('F', "a b")]);
    assert_eq!(stage.tree.cause().unwrap().text, "Play: b says no");
}

#[test]
fn a_parallel_succeeds_when_m_of_n_do_and_halts_the_rest() {
    let mut stage =
        TreeFixture::from_root(parallel(2, [play("a", "S"), play("b", "R"), play("c", "RS"), play("d", "F")]));
    stage.expect(&[('R', "a b c d"), ('S', "b c b!")]);
}

#[test]
fn a_parallel_fails_when_more_than_n_minus_m_do() {
    let mut stage = TreeFixture::from_root(parallel(2, [play("a", "F"), play("b", "RF"), play("c", "R")]));
    stage.expect(&[('R', "a b c"), ('F', "b c!")]);
}

#[test]
fn a_parallel_fails_with_the_first_failure_by_default() {
    let mut stage = TreeFixture::from_root(
        NodeSpec::new("Parallel").port("success_count", "1").children([play("a", "R"), play("b", "F")]),
    );
    stage.expect(&[('F', "a b a!")]);
    let mut stage = TreeFixture::from_root(NodeSpec::new("Parallel").children([play("a", "RS"), play("b", "S")]));
    stage.expect(&[('R', "a b"), ('S', "a")]);
}

#[test]
fn a_halted_parallel_restarts_all_children() {
    let mut stage = TreeFixture::from_root(parallel(3, [play("a", "S"), play("b", "R"), play("c", "R")]));
    stage.expect(&[('R', "a b c"), ('R', "b c")]);
    assert_eq!(stage.halt(), "b! c!");
    stage.expect(&[('R', "a b c")]);
}

#[test]
fn a_reactive_sequence_asks_again_and_interrupts() {
    let mut stage = TreeFixture::from_root(reactive_sequence([play("a", "SSF"), play("b", "R")]));
    stage.expect(&[('R', "a b"), ('R', "a b"), ('F', "a b!")]);
}

#[test]
fn a_reactive_sequence_halts_a_later_child_while_an_earlier_one_runs() {
    let mut stage = TreeFixture::from_root(reactive_sequence([play("a", "SRS"), play("b", "RS")]));
    stage.expect(&[('R', "a b"), ('R', "a b!"), ('S', "a b")]);
}

#[test]
fn a_reactive_fallback_prefers_the_first_child_at_every_tick() {
    let mut stage = TreeFixture::from_root(reactive_fallback([play("a", "FFS"), play("b", "R")]));
    stage.expect(&[('R', "a b"), ('R', "a b"), ('S', "a b!")]);
}

#[test]
fn halting_reaches_the_leaf_at_the_bottom() {
    let mut stage = TreeFixture::from_root(sequence([inverter(retry(
        2,
        fallback([play("a", "F"), timeout(9000, play("b", "R"))]),
    ))]));
    stage.expect(&[('R', "a b")]);
    assert_eq!(stage.halt(), "b!");
}

#[test]
fn a_panic_in_a_leaf_passes_through() {
    let mut stage = TreeFixture::from_root(sequence([play("a", "X")]));
    let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| stage.tick()));
    assert!(caught.is_err());
}

#[test]
fn a_cause_is_cleared_at_the_next_run() {
    let mut stage = TreeFixture::from_root(sequence([
        NodeSpec::new("ForceSuccess").child(play("a", "FS")),
        NodeSpec::new("AlwaysFailure"),
    ]));
    stage.expect(&[('F', "a")]);
    assert_eq!(stage.tree.cause().unwrap().text, "Play: a says no");
    stage.expect(&[('F', "a")]);
    assert_eq!(stage.tree.cause(), None);
}
