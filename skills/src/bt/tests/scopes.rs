//! The blackboard, ports and the scopes of sub-trees.

use super::*;
use consort_protocol::ids::PlaceId;

fn copy(value: &str, to: &str) -> NodeSpec {
    NodeSpec::new("Copy").port("value", value).port("to", to)
}

fn is_home(place: &str) -> NodeSpec {
    NodeSpec::new("IsHome").port("place", place)
}

fn main(root: NodeSpec) -> TreeSpec {
    TreeSpec::single("main", root)
}

#[test]
fn text_is_converted_to_the_type_of_its_key() {
    let mut stage = TreeFixture::from_root(sequence([copy("Home", "{here}"), is_home("{here}")]));
    stage.expect(&[('S', "")]);
    assert_eq!(stage.tree.get("here").unwrap(), Some(PlaceId::new("Home").unwrap()));
}

#[test]
fn a_value_of_the_wrong_type_fails_the_writer() {
    let mut stage = TreeFixture::from_root(sequence([copy(" bad", "{here}"), is_home("{here}")]));
    stage.expect(&[('F', "")]);
    let cause = &stage.tree.cause().unwrap().text;
    assert!(cause.starts_with("Copy: port `to`: {here}: \" bad\" is not a place: "), "{cause}");
}

#[test]
fn a_key_read_before_it_is_written_is_named() {
    let mut stage = TreeFixture::from_root(sequence([is_home("{here}"), copy("Home", "{here}")]));
    stage.expect(&[('F', "")]);
    assert_eq!(stage.tree.cause().unwrap().text, "IsHome: port `place`: {here} is empty");
}

#[test]
fn a_sub_tree_sees_only_its_remapped_keys() {
    let spec = main(sequence([copy("Home", "{here}"), NodeSpec::subtree("sub").port("where", "{here}")]))
        .with("sub", sequence([is_home("{where}"), copy("1", "{here}")]));
    let mut stage = TreeFixture::from_spec(&spec);
    stage.expect(&[('S', "")]);
    assert_eq!(stage.tree.get::<String>("here").unwrap().as_deref(), Some("Home"), "its own `here` is another");
    assert!(stage.tree.get::<String>("where").is_err());
}

#[test]
fn a_sub_tree_returns_a_value_through_a_remapped_key() {
    let spec = main(NodeSpec::subtree("sub").port("out", "{result}")).with("sub", copy("7", "{out}"));
    let mut stage = TreeFixture::from_spec(&spec);
    stage.expect(&[('S', "")]);
    assert_eq!(stage.tree.get::<String>("result").unwrap().as_deref(), Some("7"));
}

#[test]
fn a_sub_tree_can_be_given_a_fixed_value_which_is_checked() {
    let spec = |place| main(NodeSpec::subtree("sub").port("where", place)).with("sub", is_home("{where}"));
    TreeFixture::from_spec(&spec("Home")).expect(&[('S', "")]);
    TreeFixture::from_spec(&spec("Elsewhere")).expect(&[('F', "")]);
    assert!(check_error(&spec("")).contains("{sub/where}: \"\" is not a place"), "{}", check_error(&spec("")));
}

#[test]
fn two_uses_of_a_sub_tree_do_not_share_keys() {
    let sub = |place| NodeSpec::subtree("sub").port("where", place);
    let spec = main(sequence([inverter(sub("Away")), sub("Home")])).with("sub", is_home("{where}"));
    TreeFixture::from_spec(&spec).expect(&[('S', "")]);
}

#[test]
fn autoremap_shares_every_key_but_private_ones() {
    let sub = sequence([is_home("{here}"), copy("1", "{out}"), copy("2", "{_own}")]);
    let spec = main(sequence([copy("Home", "{here}"), NodeSpec::subtree("sub").autoremap()])).with("sub", sub);
    let mut stage = TreeFixture::from_spec(&spec);
    stage.expect(&[('S', "")]);
    assert_eq!(stage.tree.get::<String>("out").unwrap().as_deref(), Some("1"));
    assert!(stage.tree.get::<String>("_own").is_err());
}

#[test]
fn an_explicit_remapping_goes_before_autoremap() {
    let sub = NodeSpec::subtree("sub").autoremap().port("here", "{there}");
    let spec = main(sequence([copy("Away", "{here}"), copy("Home", "{there}"), sub])).with("sub", is_home("{here}"));
    TreeFixture::from_spec(&spec).expect(&[('S', "")]);
}

#[test]
fn a_key_with_an_at_sign_is_that_of_the_main_tree() {
    let sub = sequence([is_home("{@here}"), copy("1", "{@out}"), copy("2", "{out}")]);
    let spec = main(sequence([copy("Home", "{here}"), NodeSpec::subtree("middle")]))
        .with("middle", NodeSpec::subtree("sub"))
        .with("sub", sub);
    let mut stage = TreeFixture::from_spec(&spec);
    stage.expect(&[('S', "")]);
    assert_eq!(stage.tree.get::<String>("out").unwrap().as_deref(), Some("1"));
}

#[test]
fn a_sub_tree_with_an_unset_input_is_rejected() {
    let spec = main(NodeSpec::subtree("sub")).with("sub", is_home("{where}"));
    assert_eq!(
        check_error(&spec),
        "main: sub/IsHome: `place` reads {where}, which is neither written nor passed to the sub-tree"
    );
}

#[test]
fn unwritten_keys_of_the_main_tree_are_its_inputs() {
    let root = sequence([is_home("{to}"), copy("{mine}", "{mine}"), copy("1", "{written}"), copy("{written}", "{_}")]);
    let blueprint = registry().check(&main(root)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(blueprint.inputs(), [TreeInput { key: "to".to_owned(), port_type: PortType::Place, required: true }]);
    let mut tree = blueprint.instantiate(&CallLog::default());
    let error = tree.set("too", "Home").unwrap_err().to_string();
    assert_eq!(error, "no port uses the key {too}; used are _, mine, to, written");
}
