//! Pre- and postconditions, and skipped nodes.

use super::*;
use ScriptAttribute::{FailureIf, OnFailure, OnHalted, OnSuccess, Post, SkipIf, SuccessIf, While};

/// A tree whose key `x` is 0 at the start. `n` counts the executions of postconditions.
fn stage(root: NodeSpec) -> TreeFixture {
    let declared = NodeSpec::new("Script").port("code", "x := 0; n := 0; order := ''");
    let once = NodeSpec::new("RunOnce").port("then_skip", "true").child(declared);
    TreeFixture::from_root(sequence([once, root]))
}

fn set(code: &str) -> NodeSpec {
    NodeSpec::new("Script").port("code", code)
}

#[test]
fn preconditions_replace_the_tick_of_an_idle_node() {
    for (attribute, status) in [(FailureIf, 'F'), (SuccessIf, 'S'), (SkipIf, '-')] {
        TreeFixture::from_root(play("a", "S").script(attribute, "1 > 0")).expect(&[(status, "")]);
        TreeFixture::from_root(play("a", "S").script(attribute, "1 < 0")).expect(&[('S', "a")]);
    }
    TreeFixture::from_root(play("a", "S").script(While, "1 > 0")).expect(&[('S', "a")]);
    TreeFixture::from_root(play("a", "S").script(While, "1 < 0")).expect(&[('-', "")]);
}

#[test]
fn preconditions_are_evaluated_in_order() {
    let all = |from: usize| {
        let attributes = [FailureIf, SuccessIf, SkipIf].into_iter().skip(from);
        attributes.fold(play("a", "S").script(While, "false"), |node, attribute| node.script(attribute, "true"))
    };
    for (from, status) in [(0, 'F'), (1, 'S'), (2, '-'), (3, '-')] {
        TreeFixture::from_root(all(from)).expect(&[(status, "")]);
    }
}

#[test]
fn a_running_node_evaluates_only_while() {
    let child = [FailureIf, SuccessIf, SkipIf]
        .into_iter()
        .fold(play("a", "RRS"), |node, attribute| node.script(attribute, "x == 1"));
    let mut tree = stage(sequence([parallel(2, [child, set("x = 1")])]));
    tree.expect(&[('R', "a"), ('R', "a"), ('S', "a")]);
}

#[test]
fn a_false_while_halts_the_running_node_and_skips_it() {
    let child = sequence([play("a", "R")]).script(While, "x < 2").script(OnHalted, "n += 10");
    let mut tree = stage(NodeSpec::new("ReactiveSequence").children([set("x += 1"), child, set("n += 1")]));
    tree.expect(&[('R', "a"), ('S', "a!")]);
    assert_eq!(tree.tree.get::<f64>("n").unwrap(), Some(11.0));
}

#[test]
fn postconditions_run_after_the_result() {
    let noted = |node: NodeSpec| {
        node.script(OnSuccess, "order += 's'").script(OnFailure, "order += 'f'").script(Post, "order += 'p'")
    };
    let order = |root: NodeSpec, statuses: &[(char, &str)]| {
        let mut tree = stage(noted(root));
        tree.expect(statuses);
        tree.tree.get::<String>("order").unwrap().unwrap()
    };
    assert_eq!(order(play("a", "RS"), &[('R', "a"), ('S', "a")]), "sp");
    assert_eq!(order(play("a", "F"), &[('F', "a")]), "fp");
    assert_eq!(order(play("a", "F").script(SuccessIf, "true"), &[('S', "")]), "sp");
    assert_eq!(order(play("a", "F").script(SkipIf, "true"), &[('S', "")]), "");
}

#[test]
fn a_halted_node_runs_its_script_once() {
    let child = play("a", "R").script(OnHalted, "n += 1");
    let mut tree = stage(timeout(1000, inverter(child)));
    tree.at(0.0).expect(&[('R', "a")]);
    tree.at(1.0).expect(&[('F', "a!")]);
    assert_eq!(tree.halt(), "");
    assert_eq!(tree.tree.get::<f64>("n").unwrap(), Some(1.0));
}

#[test]
fn an_empty_key_in_a_condition_is_an_error_with_its_place() {
    let root = fallback([play("a", "S").script(SkipIf, "late"), set("late := true")]).script(Post, "n := 1");
    let mut tree = TreeFixture::from_root(root);
    tree.expect(&[('F', "")]);
    assert_eq!(tree.tree.cause().unwrap().text, "main: main/Play: script `_skipIf`: `late`: {late} is empty");
    assert_eq!(tree.tree.get::<f64>("n").unwrap(), None, "no further script runs");
}

#[test]
fn a_failing_postcondition_fails_the_tree() {
    let mut tree =
        TreeFixture::from_root(NodeSpec::new("ForceSuccess").child(play("a", "S").script(Post, "x := 1 / 0")));
    tree.expect(&[('F', "a")]);
    let cause = &tree.tree.cause().unwrap().text;
    assert!(cause.starts_with("main: main/Play: script `_post`: `x := 1 / 0`: it evaluates to inf"), "{cause}");
}

#[test]
fn composites_continue_after_a_skipped_child() {
    let skipped = || play("skipped", "S").script(SkipIf, "true");
    for kind in ["Sequence", "SequenceWithMemory", "ReactiveSequence"] {
        let node = || NodeSpec::new(kind);
        TreeFixture::from_root(node().children([skipped(), play("a", "S"), skipped()])).expect(&[('S', "a")]);
        TreeFixture::from_root(node().children([skipped(), play("a", "F"), play("b", "S")])).expect(&[('F', "a")]);
        TreeFixture::from_root(node().children([skipped(), skipped()])).expect(&[('-', ""), ('-', "")]);
    }
    for kind in ["Fallback", "ReactiveFallback"] {
        let node = || NodeSpec::new(kind);
        TreeFixture::from_root(node().children([skipped(), play("a", "F"), skipped()])).expect(&[('F', "a")]);
        TreeFixture::from_root(node().children([skipped(), play("a", "S"), play("b", "S")])).expect(&[('S', "a")]);
        TreeFixture::from_root(node().children([skipped(), skipped()])).expect(&[('-', "")]);
    }
    let tree = NodeSpec::new("AsyncSequence").children([skipped(), play("a", "S"), skipped()]);
    TreeFixture::from_root(tree).expect(&[('R', "a"), ('S', "")]);
    TreeFixture::from_root(NodeSpec::new("AsyncFallback").children([skipped(), skipped()])).expect(&[('-', "")]);
}

#[test]
fn decorators_pass_a_skipped_child_on() {
    let skipped = || play("skipped", "S").script(SkipIf, "true");
    for node in [
        inverter(skipped()),
        NodeSpec::new("ForceSuccess").child(skipped()),
        NodeSpec::new("ForceFailure").child(skipped()),
        retry(2, skipped()),
        repeat(2, skipped()),
        timeout(10, skipped()),
        NodeSpec::new("Delay").port("delay_msec", "0").child(skipped()),
        NodeSpec::new("RunOnce").child(skipped()),
    ] {
        TreeFixture::from_root(node).expect(&[('-', ""), ('-', "")]);
    }
    TreeFixture::from_root(NodeSpec::new("KeepRunningUntilFailure").child(skipped())).expect(&[('R', "")]);
    let each = NodeSpec::new("LoopString").port("queue", "1;2").port("value", "{each}");
    TreeFixture::from_root(each.child(skipped())).expect(&[('S', "")]);
}

#[test]
fn a_skipped_repetition_keeps_its_count() {
    // The child fails once in each tick, and is then skipped.
    let child = play("a", "F").script(SkipIf, "x == 1").script(OnFailure, "x = 1");
    let mut tree = stage(sequence([set("x = 0"), retry(3, child)]));
    tree.expect(&[('S', "a"), ('S', "a"), ('F', "a"), ('S', "a")]);
}

#[test]
fn a_parallel_ticks_a_skipped_child_again() {
    let child = || play("a", "S").script(SkipIf, "x < 2");
    let root = |count: &str| {
        let node = NodeSpec::new("Parallel").port("success_count", count);
        node.children([NodeSpec::new("Sequence").children([set("x += 1"), play("b", "R")]), child()])
    };
    // The first child is running, so `x` stays 1.
    stage(root("1")).expect(&[('R', "b"), ('R', "b")]);
    let skipped = || play("a", "S").script(SkipIf, "true");
    let parallel = |count: &str| NodeSpec::new("Parallel").port("success_count", count);
    TreeFixture::from_root(parallel("-1").children([skipped(), play("b", "S")])).expect(&[('S', "b")]);
    TreeFixture::from_root(parallel("2").children([skipped(), play("b", "S")])).expect(&[('R', "b"), ('R', "")]);
    TreeFixture::from_root(parallel("-1").children([skipped(), skipped()])).expect(&[('-', "")]);
    let all = || NodeSpec::new("ParallelAll");
    TreeFixture::from_root(all().children([skipped(), play("b", "RS")])).expect(&[('R', "b"), ('S', "b")]);
    TreeFixture::from_root(all().children([skipped(), skipped()])).expect(&[('-', "")]);
}

#[test]
fn conditions_of_a_sub_tree_belong_to_the_enclosing_tree() {
    let sub = || NodeSpec::subtree("sub").script(SkipIf, "x == 0").script(OnSuccess, "x = 5");
    let spec = |code: &str| {
        let root = NodeSpec::new("Sequence").children([set(code), sub()]);
        TreeSpec::single("main", root)
            .with("sub", sequence([set("x := 'own'"), play("a", "S").script(SkipIf, "x == 1")]))
    };
    TreeFixture::from_spec(&spec("x := 0")).expect(&[('S', "")]);
    let mut tree = TreeFixture::from_spec(&spec("x := 1"));
    tree.expect(&[('F', "")]);
    let cause = &tree.tree.cause().unwrap().text;
    assert!(cause.starts_with("main: sub/Play: script `_skipIf`: `x == 1`: \"own\" is not a number"), "{cause}");
    let spec = TreeSpec::single("main", sequence([set("x := 1"), sub()])).with("sub", play("a", "S"));
    let mut tree = TreeFixture::from_spec(&spec);
    tree.expect(&[('S', "a")]);
    assert_eq!(tree.tree.get::<f64>("x").unwrap(), Some(5.0));
}
