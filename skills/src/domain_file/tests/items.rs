//! Items that goals move, and task types that hand items over.

use super::*;

#[test]
fn items_come_from_nothing_and_go_to_nothing() {
    let moves = |options: &str, from: &str, to: &str| {
        check(&format!(
            "domain: d\nactions: {{ a: {{ {options} simulate: {{ moves: {{ from: {from}, to: {to} }} }} }} }}"
        ))
    };
    assert!(moves("", "nothing", "table").is_ok());
    assert!(moves("", "container", "nothing").is_ok());
    let place = "actions.a.simulate.moves";
    let same = format!("{place}: `from` and `to` are the same; allowed are two different holders");
    assert_eq!(moves("", "nothing", "nothing").unwrap_err(), [same]);
    let unmoved = format!("{place}: an action that moves items needs `hands_over: true`");
    assert_eq!(moves("repeatable: true,", "arm", "nothing").unwrap_err(), [unmoved]);
}

#[test]
fn a_task_type_hands_items_over_if_an_action_of_it_does() {
    let domain = r#"
domain: loading
actions:
  load: { hands_over: true, repeatable: true }
  press: { hands_over: false }
  water: {}
  look: { repeatable: true }
  deliver: { by_people: true }
tasks:
  load: { action: load }
  press: { action: press }
  pour: { action: water }
  look: { action: look }
  deliver: { action: deliver }
  round: { tree: round.xml, estimate: { time_s: "1.0" } }
"#;
    let handing_over = |round: &str| {
        let root = format!(r#"<root BTCPP_format="4"><BehaviorTree ID="round">{round}</BehaviorTree></root>"#);
        let trees = BTreeMap::from([("round.xml".to_owned(), root)]);
        let domain = DomainFile::check(yaml::parse(domain).unwrap(), &trees, &[]).unwrap();
        let types = domain.task_types().filter(|(_, schema)| schema.hands_over == Some(true));
        types.map(|(name, _)| name.to_string()).collect::<Vec<_>>()
    };
    let declared = ["load", "pour"];
    let with_round = ["load", "pour", "round"];
    assert_eq!(handing_over(r#"<Sequence><press/><look/><wait time="1"/></Sequence>"#), declared);
    assert_eq!(handing_over(r#"<Sequence><look/><Fallback><load/><press/></Fallback></Sequence>"#), with_round);
    assert_eq!(handing_over(r#"<grasp object="cup"/>"#), with_round, "an action of the standard domain");
    assert_eq!(handing_over(r#"<AskPerson role="nurse" message="Load me"/>"#), with_round, "a person may load it");
}

/// The items of the shipped missions move in tasks of these types.
#[test]
fn standard_task_types_hand_items_over_as_their_names_say() {
    let types = crate::domain::standard_domain().task_types();
    let handing_over = types.filter(|(_, schema)| schema.hands_over == Some(true));
    let names: Vec<String> = handing_over.map(|(name, _)| name.to_string()).collect();
    assert_eq!(names, ["deposit", "grasp", "pick_up"]);
}
