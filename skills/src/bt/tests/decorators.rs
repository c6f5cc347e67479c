//! Decorators, and time.

use super::*;

#[test]
fn an_inverter_swaps_success_and_failure() {
    TreeFixture::from_root(inverter(play("a", "RSF"))).expect(&[('R', "a"), ('F', "a"), ('S', "a")]);
}

#[test]
fn forced_results_wait_for_the_child() {
    TreeFixture::from_root(NodeSpec::new("ForceSuccess").child(play("a", "RF"))).expect(&[('R', "a"), ('S', "a")]);
    TreeFixture::from_root(NodeSpec::new("ForceFailure").child(play("a", "RS"))).expect(&[('R', "a"), ('F', "a")]);
}

#[test]
fn a_retry_tries_as_often_as_it_may() {
    TreeFixture::from_root(retry(3, play("a", "FFS"))).expect(&[('S', "a a a")]);
    TreeFixture::from_root(retry(3, play("a", "FRFFS"))).expect(&[('R', "a a"), ('F', "a a"), ('S', "a")]);
    TreeFixture::from_root(retry(0, play("a", "S"))).expect(&[('F', "")]);
}

#[test]
fn a_halted_retry_restarts_its_count() {
    let mut stage = TreeFixture::from_root(retry(2, play("a", "FRFFF")));
    stage.expect(&[('R', "a a")]);
    assert_eq!(stage.halt(), "a!");
    stage.expect(&[('F', "a a")]);
}

#[test]
fn a_repeat_ends_with_the_first_failure() {
    TreeFixture::from_root(repeat(3, play("a", "SRSS"))).expect(&[('R', "a a"), ('S', "a a")]);
    TreeFixture::from_root(repeat(3, play("a", "SF"))).expect(&[('F', "a a")]);
}

#[test]
fn an_unlimited_loop_runs_one_iteration_per_tick() {
    let mut stage = TreeFixture::from_root(NodeSpec::new("Repeat").port("num_cycles", "-1").child(play("a", "S")));
    stage.at(5.0).expect(&[('R', "a"), ('R', "a")]);
}

#[test]
fn nested_loops_cannot_block_a_tick() {
    let many = |child| NodeSpec::new("Repeat").port("num_cycles", "2000000000").child(child);
    let mut stage = TreeFixture::from_root(many(many(many(NodeSpec::new("AlwaysSuccess")))));
    stage.expect(&[('R', ""), ('R', "")]);
}

#[test]
fn a_long_loop_continues_at_the_next_tick() {
    let mut stage = TreeFixture::from_root(repeat(MAX_LOOP_ITERATIONS_PER_TICK + 500, play("a", "S")));
    let (status, log) = stage.tick();
    assert_eq!((status, log.split(' ').count()), ('R', MAX_LOOP_ITERATIONS_PER_TICK as usize));
    let (status, log) = stage.tick();
    assert_eq!((status, log.split(' ').count()), ('S', 500));
}

#[test]
fn a_timeout_halts_its_child_on_world_time() {
    let mut stage = TreeFixture::from_root(timeout(1500, play("a", "R")));
    stage.at(10.0).expect(&[('R', "a")]);
    stage.at(11.4).expect(&[('R', "a")]);
    stage.at(11.5).expect(&[('F', "a!")]);
    assert_eq!(stage.tree.cause().unwrap().text, "Timeout: not complete at 11.5 s of world time, its time limit");
    stage.at(12.0).expect(&[('R', "a")]);
    stage.at(13.4).expect(&[('R', "a")]);
}

#[test]
fn a_timeout_of_zero_is_no_limit() {
    let mut stage = TreeFixture::from_root(timeout(0, play("a", "R")));
    stage.at(0.0).expect(&[('R', "a")]);
    stage.at(1.0e6).expect(&[('R', "a")]);
}

#[test]
fn a_sleep_ends_on_world_time() {
    let mut stage = TreeFixture::from_root(NodeSpec::new("Sleep").port("msec", "2000"));
    stage.at(1.0).expect(&[('R', "")]);
    stage.at(3.0).expect(&[('S', ""), ('R', "")]);
}

fn for_each(queue: &str, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("LoopString").port("queue", queue).port("value", "{each}").child(child)
}

#[test]
fn a_loop_over_a_list_passes_each_element_to_its_child() {
    let child = NodeSpec::new("Play").port("as", "{each}").port("plays", "S");
    let mut stage = TreeFixture::from_root(for_each(
        "x;y;z",
        sequence([child, NodeSpec::new("Copy").port("value", "{each}").port("to", "{last}")]),
    ));
    // The fake leaf keeps the name from its first tick.
    stage.expect(&[('S', "x x x")]);
    assert_eq!(stage.tree.get::<String>("last").unwrap().as_deref(), Some("z"));
}

#[test]
fn a_loop_over_a_list_fails_with_its_child_and_restarts() {
    let mut stage = TreeFixture::from_root(for_each("x;y", play("a", "SRFSS")));
    stage.expect(&[('R', "a a"), ('F', "a"), ('S', "a a")]);
}

#[test]
fn a_loop_over_an_empty_list_returns_if_empty() {
    TreeFixture::from_root(for_each("", play("a", "S"))).expect(&[('S', "")]);
    TreeFixture::from_root(for_each("", play("a", "S")).port("if_empty", "FAILURE")).expect(&[('F', "")]);
}
