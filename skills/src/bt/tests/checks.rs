//! Errors reported before a tree is created, with their texts.

use super::*;

fn main(root: NodeSpec) -> TreeSpec {
    TreeSpec::single("main", root)
}

#[test]
fn an_unknown_node_is_reported_with_the_known_nodes() {
    let error = check_error(&main(sequence([NodeSpec::new("Pay")])));
    assert!(
        error.starts_with("main: main/Pay: there is no node `Pay`; known are Sequence, AsyncSequence, "),
        "{error}"
    );
    assert!(error.ends_with("Copy, IsHome, Play"), "{error}");
}

#[test]
fn ports_are_checked() {
    let home = || NodeSpec::new("IsHome");
    for (node, expected) in [
        (home(), "main: main/IsHome: port `place` (a place) is missing"),
        (
            home().port("plaice", "A").port("place", "B"),
            "main: main/IsHome: there is no port `plaice`; allowed are place",
        ),
        (
            retry(1, home().port("place", "A")).port("num_attempts", "many"),
            "main: main/RetryUntilSuccessful: port `num_attempts`: \"many\" is not a whole number: allowed is a whole number such as 3",
        ),
        (
            retry(1, home().port("place", "A")).port("num_attempts", "-2"),
            "main: main/RetryUntilSuccessful: port `num_attempts`: \"-2\" is rejected: allowed is -1 to 2147483647",
        ),
        (
            NodeSpec::new("Copy").port("value", "1").port("to", "here"),
            "main: main/Copy: port `to` is written by the node: bind it to a key such as {to}, not to \"here\"",
        ),
        (
            sequence([home().port("place", "{x}"), NodeSpec::new("Sleep").port("msec", "{x}").named("nap")]),
            "main: main/Sleep (nap): port `msec` takes a whole number, but its key {x} is a place elsewhere",
        ),
    ] {
        assert_eq!(check_error(&main(node)), expected);
    }
}

#[test]
fn children_are_counted() {
    let leaf = || play("a", "S");
    for (node, expected) in [
        (leaf().child(leaf()), "main: main/Play: it has 1 children; allowed is none"),
        (NodeSpec::new("Inverter"), "main: main/Inverter: it has 0 children; allowed is exactly 1"),
        (inverter(leaf()).child(leaf()), "main: main/Inverter: it has 2 children; allowed is exactly 1"),
        (sequence([]), "main: main/Sequence: it has 0 children; allowed is 1 or more"),
        (
            parallel(3, [leaf()]),
            "main: main/Parallel: it has 1 children; allowed is 3 or more, as `success_count` is 3",
        ),
    ] {
        assert_eq!(check_error(&main(node)), expected);
    }
}

#[test]
fn an_explicit_kind_must_be_the_right_one() {
    let node = NodeSpec { kind: Some(NodeKind::Condition), ..play("a", "S") };
    assert_eq!(check_error(&main(node)), "main: main/Play: `Play` is written as <Condition>, but is of kind <Action>");
}

#[test]
fn sub_trees_must_exist_and_not_form_cycles() {
    assert_eq!(
        check_error(&main(NodeSpec::subtree("sub"))),
        "main: main/sub: there is no tree `sub` in this file; there are main"
    );
    let circle =
        main(sequence([NodeSpec::subtree("a")])).with("a", NodeSpec::subtree("b")).with("b", NodeSpec::subtree("a"));
    assert_eq!(check_error(&circle), "main: b/a: the sub-trees form a cycle: main → a → b → a");
    let given = main(NodeSpec::subtree("a").port("x", "1").port("y", "2"))
        .with("a", NodeSpec::new("IsHome").port("place", "{x}"));
    assert_eq!(check_error(&given), "main: main/a: there is no port `y`; allowed are x");
    let absent = TreeSpec { main: "other".to_owned(), ..main(play("a", "S")) };
    assert_eq!(check_error(&absent), "main: there is no tree `other` in this file; there are main");
}

#[test]
fn sub_trees_that_double_at_every_level_are_rejected() {
    let mut spec = main(NodeSpec::subtree("t0"));
    for level in 0..40 {
        let next = || NodeSpec::subtree(&format!("t{}", level + 1));
        spec = spec.with(&format!("t{level}"), sequence([next(), next()]));
    }
    let error = check_error(&spec.with("t40", play("a", "S")));
    assert!(error.ends_with("the tree has more than 10000 nodes, sub-trees included"), "{error}");
}

#[test]
fn the_depth_limit_rejects_deeper_trees_only() {
    let deep = |levels: usize| (1..levels).fold(play("a", "RS"), |tree, _| inverter(inverter(tree)));
    let error = check_error(&main(deep(51)));
    assert!(error.ends_with("it is nested deeper than 100 levels, sub-trees included"), "{error}");
    let mut stage = TreeFixture::from_root(deep(50));
    stage.expect(&[('R', "a"), ('S', "a")]);
}

#[test]
fn a_name_is_registered_once_and_for_a_leaf() {
    let mut registry = registry();
    let never = |_: &CallLog| -> Box<dyn Leaf> { Box::new(SyncLeaf(|_: &mut LeafContext<'_, '_>| Ok(true))) };
    let mut reject = |id, kind| registry.register(NodeManifest::new(id, kind, []), never).unwrap_err().to_string();
    assert_eq!(reject("Play", NodeKind::Action), "a node `Play` is already registered");
    assert_eq!(reject("Sequence", NodeKind::Action), "a node `Sequence` is already registered");
    assert_eq!(reject("Mine", NodeKind::Control), "`Mine` is of kind <Control>; allowed are <Action> and <Condition>");
}
