//! Nodes that choose a child, and the remaining nodes of BehaviorTree.CPP 4.

use super::*;

fn node(id: &str) -> NodeSpec {
    NodeSpec::new(id)
}

#[test]
fn if_then_else_keeps_its_choice() {
    let tree = |condition| node("IfThenElse").children([play("if", condition), play("a", "RS"), play("b", "RF")]);
    TreeFixture::from_root(tree("RSF")).expect(&[('R', "if"), ('R', "if a"), ('S', "a"), ('R', "if b"), ('F', "b")]);
    let two = node("IfThenElse").children([play("if", "F"), play("a", "S")]);
    TreeFixture::from_root(two).expect(&[('F', "if")]);
    let mut stage = TreeFixture::from_root(tree("S"));
    stage.expect(&[('R', "if a")]);
    assert_eq!(stage.halt(), "a!");
    stage.expect(&[('S', "if a")]);
}

#[test]
fn while_do_else_asks_at_every_tick() {
    let tree = node("WhileDoElse").children([play("if", "SSFFS"), play("a", "R"), play("b", "RS")]);
    TreeFixture::from_root(tree).expect(&[
        ('R', "if a"),
        ('R', "if a"),
        ('R', "if a! b"),
        ('S', "if b"),
        ('R', "if a"),
    ]);
    let two = node("WhileDoElse").children([play("if", "SF"), play("a", "R")]);
    TreeFixture::from_root(two).expect(&[('R', "if a"), ('F', "if a!")]);
}

#[test]
fn branches_count_their_children() {
    let error = |node| check_error(&TreeSpec::single("main", node));
    let leaf = || play("a", "S");
    assert_eq!(
        error(node("IfThenElse").children([leaf()])),
        "main: main/IfThenElse: it has 1 children; allowed is 2 or 3"
    );
    assert_eq!(
        error(node("WhileDoElse").children([leaf(), leaf(), leaf(), leaf()])),
        "main: main/WhileDoElse: it has 4 children; allowed is 2 or 3"
    );
    let switch = node("Switch2").port("variable", "1").port("case_1", "1").port("case_2", "2");
    assert_eq!(
        error(switch.children([leaf(), leaf()])),
        "main: main/Switch2: it has 2 children; allowed is exactly 3: one for each case, then the default"
    );
    assert_eq!(
        error(node("Switch3").port("case_1", "1")),
        "main: main/Switch3: port `variable` (any value) is missing"
    );
}

#[test]
fn a_switch_chooses_the_child_of_its_variable() {
    let switch = |variable: &str| {
        let ports = node("Switch2").port("variable", "{v}").port("case_1", "1").port("case_2", "two");
        let switch = ports.children([play("a", "S"), play("b", "S"), play("default", "S")]);
        sequence([node("Script").port("code", &format!("v := {variable}")), switch])
    };
    for (variable, child) in [("1", "a"), ("1.0", "a"), ("'two'", "b"), ("2", "default"), ("'1.0'", "a")] {
        TreeFixture::from_root(switch(variable)).expect(&[('S', child)]);
    }
}

#[test]
fn a_switch_without_a_value_takes_the_default() {
    let switch = node("Switch2").port("variable", "{v}").port("case_1", "1").port("case_2", "2");
    let switch = switch.children([play("a", "S"), play("b", "S"), play("default", "S")]);
    let later = node("Script").port("code", "v := 2");
    TreeFixture::from_root(sequence([switch, later])).expect(&[('S', "default"), ('S', "b")]);
}

#[test]
fn a_switch_halts_the_child_of_another_case() {
    let switch = node("Switch2").port("variable", "{v}").port("case_1", "1").port("case_2", "2");
    let switch = switch.children([play("a", "R"), play("b", "R"), play("default", "S")]);
    let next = node("Script").port("code", "v = v + 1");
    let start = node("RunOnce").child(node("Script").port("code", "v := 0"));
    let mut stage = TreeFixture::from_root(sequence([start, reactive_sequence([next, switch])]));
    stage.expect(&[('R', "a"), ('R', "a! b"), ('S', "b! default")]);
}

#[test]
fn a_sequence_with_memory_continues_after_a_failure_or_a_halt() {
    let tree = node("SequenceWithMemory").children([play("a", "S"), play("b", "FRS"), play("c", "S")]);
    let mut stage = TreeFixture::from_root(tree);
    stage.expect(&[('F', "a b"), ('R', "b")]);
    assert_eq!(stage.halt(), "b!");
    stage.expect(&[('S', "b c"), ('S', "a b c")]);
}

#[test]
fn an_asynchronous_composite_returns_between_its_children() {
    let children = || [play("a", "S"), play("b", "RS"), play("c", "S")];
    let mut stage = TreeFixture::from_root(node("AsyncSequence").children(children()));
    stage.expect(&[('R', "a"), ('R', "b"), ('S', "b c")]);
    let tree = node("AsyncFallback").children([play("a", "F"), play("b", "F"), play("c", "F")]);
    TreeFixture::from_root(tree).expect(&[('R', "a"), ('R', "b"), ('F', "c")]);
}

#[test]
fn a_node_that_keeps_running_ends_with_the_failure_of_its_child() {
    let mut stage = TreeFixture::from_root(node("KeepRunningUntilFailure").child(play("a", "SRF")));
    stage.expect(&[('R', "a"), ('R', "a"), ('F', "a")]);
}

#[test]
fn a_delay_starts_its_child_later() {
    let mut stage = TreeFixture::from_root(node("Delay").port("delay_msec", "1500").child(play("a", "RS")));
    stage.at(1.0).expect(&[('R', "")]);
    stage.at(2.4).expect(&[('R', "")]);
    stage.at(2.5).expect(&[('R', "a"), ('S', "a"), ('R', "")]);
    assert_eq!(stage.halt(), "", "the child does not run");
    stage.at(3.0).expect(&[('R', "")]);
    stage.at(4.5).expect(&[('S', "a")]);
}

#[test]
fn a_node_runs_once_and_is_then_skipped_or_repeats_its_status() {
    let mut stage = TreeFixture::from_root(node("RunOnce").child(play("a", "RF")));
    stage.expect(&[('R', "a")]);
    assert_eq!(stage.halt(), "a!");
    stage.expect(&[('F', "a"), ('-', ""), ('-', "")]);
    let mut stage = TreeFixture::from_root(node("RunOnce").port("then_skip", "false").child(play("a", "F")));
    stage.expect(&[('F', "a"), ('F', "")]);
}

#[test]
fn negative_counts_of_a_parallel_are_relative_to_its_children() {
    let parallel = |success: &str, failure: &str, plays: [&str; 3]| {
        let node = node("Parallel").port("success_count", success).port("failure_count", failure);
        TreeFixture::from_root(node.children(plays.iter().zip(["a", "b", "c"]).map(|(plays, name)| play(name, plays))))
    };
    parallel("-2", "3", ["S", "R", "RS"]).expect(&[('R', "a b c"), ('S', "b c b!")]);
    parallel("-3", "3", ["R", "S", "R"]).expect(&[('S', "a b a!")]);
    parallel("1", "-1", ["F", "F", "RS"]).expect(&[('R', "a b c"), ('S', "c")]);
    parallel("1", "-2", ["F", "F", "R"]).expect(&[('F', "a b")]);
    parallel("1", "-1", ["F", "F", "F"]).expect(&[('F', "a b c")]);
}

#[test]
fn a_parallel_of_all_waits_for_every_child() {
    let all = |max: &str, plays: [&str; 3]| {
        let node = node("ParallelAll").port("max_failures", max);
        TreeFixture::from_root(node.children(plays.iter().zip(["a", "b", "c"]).map(|(plays, name)| play(name, plays))))
    };
    all("1", ["S", "F", "RS"]).expect(&[('R', "a b c"), ('F', "c"), ('F', "a b c")]);
    all("2", ["S", "F", "RS"]).expect(&[('R', "a b c"), ('S', "c")]);
    all("-1", ["F", "F", "RS"]).expect(&[('R', "a b c"), ('S', "c")]);
    all("-1", ["F", "F", "F"]).expect(&[('F', "a b c")]);
    let mut stage = all("1", ["S", "R", "R"]);
    stage.expect(&[('R', "a b c")]);
    assert_eq!(stage.halt(), "b! c!");
    let error =
        check_error(&TreeSpec::single("main", node("ParallelAll").port("max_failures", "2").child(play("a", "S"))));
    assert_eq!(error, "main: main/ParallelAll: it has 1 children; allowed is 2 or more, as `max_failures` is 2");
}
