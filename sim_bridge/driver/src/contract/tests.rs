use super::*;
use consort_protocol::cause::CauseClass;
use serde_json::{Value, json};

fn contract() -> Contract {
    let form = serde_json::from_value(json!({
        "domain": "cleaning",
        "actions": {
            "vacuum": {
                "parameters": { "passes": { "type": "integer" }, "speed": { "type": "number", "optional": true } },
                "results": { "dust_g": { "type": "number" } },
                "feedback": {
                    "cleaned": { "type": "number", "minimum": 0, "maximum": 1 },
                    "round": { "type": "integer" },
                    "note": { "type": "text" }, "remark": { "type": "text" },
                },
                "failures": { "bag_full": { "class": "precondition", "moved_nothing": true } },
            },
        },
        "readings": {
            "bag_g": { "type": "number", "minimum": 0, "maximum": 50 },
            "bag_full": { "type": "bool" },
            "passes": { "type": "integer" },
            "mode": { "type": "text", "one_of": ["eco", "strong"] },
            "note": { "type": "text" },
        },
    }));
    let domain = DomainFile::check(form.unwrap(), &BTreeMap::new(), &[]).unwrap();
    Contract::new([&domain])
}

fn check(actions: Value) -> Result<(), String> {
    let actions = serde_json::from_value(actions).unwrap();
    contract().check(1, &actions).map_err(|error| error.to_string())
}

#[test]
fn declared_and_standard_actions_are_accepted() {
    let vacuum = json!({
        "parameters": { "passes": { "type": "integer" } },
        "results": { "dust_g": { "type": "number" } },
    });
    assert_eq!(check(json!({ "wait": {}, "vacuum": vacuum })), Ok(()));
    assert_eq!(check(json!({ "vacuum": {} })), Ok(()), "it states neither parameters nor results");
}

#[test]
fn the_code_of_a_failure_is_declared_or_standard() {
    let failure = |action, code| contract().failure(action, code, "why");
    let (declared, none) = failure("vacuum", Some("bag_full"));
    assert_eq!((declared.class, declared.moved_nothing, none), (CauseClass::Precondition, true, None));
    assert_eq!(declared.message, "bag_full: why");
    let standard = ActionError::new(ErrorCode::Blocked, "why");
    assert_eq!(failure("vacuum", Some("blocked")), (standard.clone(), None));
    assert_eq!(failure("wait", Some("blocked")), (standard, None));
    let failed = ActionError::new(ErrorCode::Failed, "why");
    assert_eq!(failure("vacuum", None), (failed.clone(), None));
    let (error, problem) = failure("vacuum", Some("bag_ful"));
    let problem = problem.unwrap();
    assert_eq!(error, failed);
    assert!(problem.starts_with("result: code: vacuum has no failure `bag_ful`; allowed: bag_full, "), "{problem}");
    assert!(problem.ends_with("did you mean `bag_full`?"), "{problem}");
}

#[test]
fn a_hello_that_differs_from_the_domain_is_rejected_with_its_place() {
    let of = |parameters: Value| check(json!({ "vacuum": { "parameters": parameters } })).unwrap_err();
    assert_eq!(of(json!({})), "hello: actions.vacuum.parameters.passes: is missing; the domain declares it");
    let without_optional = json!({ "vacuum": { "parameters": { "passes": { "type": "integer" } } } });
    assert_eq!(check(without_optional), Ok(()), "the driver ignores `speed`");
    assert_eq!(
        of(json!({ "passes": { "type": "text" } })),
        "hello: actions.vacuum.parameters.passes: type: the domain declares \"integer\""
    );
    assert_eq!(
        of(json!({ "pases": { "type": "integer" } })),
        "hello: actions.vacuum.parameters.pases: the domain declares no such parameter; allowed: passes, speed; did \
         you mean `passes`?"
    );
    let without_result = check(json!({ "vacuum": { "results": {} } })).unwrap_err();
    assert_eq!(without_result, "hello: actions.vacuum.results.dust_g: is missing; the domain declares it");
    let feedback = json!({ "cleaned": { "type": "text" } });
    let wrong_feedback = check(json!({ "vacuum": { "feedback": feedback } })).unwrap_err();
    assert_eq!(wrong_feedback, "hello: actions.vacuum.feedback.cleaned: type: the domain declares \"number\"");
    let undeclared = check(json!({ "vacum": {} })).unwrap_err();
    assert!(undeclared.starts_with("hello: actions.vacum: no domain declares this action; allowed: "));
    assert!(undeclared.ends_with("did you mean `vacuum`?"), "{undeclared}");
    assert_eq!(contract().check(2, &BTreeMap::new()), Err(ContractError::Protocol(2)));
    assert_eq!(contract().check(1, &BTreeMap::new()), Err(ContractError::NoActions));
}

#[test]
fn declared_feedback_is_accepted_and_other_feedback_is_dropped() {
    let accept = |action: &str, values: &[(&str, Scalar)]| {
        let values = values.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        let (accepted, problems) = contract().accept_feedback(&action.parse().unwrap(), &values);
        (accepted, problems.iter().map(ToString::to_string).collect::<Vec<_>>())
    };
    let named = |name: &str, value| BTreeMap::from([(name.to_owned(), value)]);
    let sent = [("cleaned", Scalar::Integer(1)), ("clened", Scalar::Bool(true)), ("round", Scalar::Number(1.5))];
    let (accepted, problems) = accept("vacuum", &sent);
    assert_eq!(accepted, named("cleaned", Scalar::Number(1.0)), "a whole number is a number, too");
    let allowed = "allowed: cleaned, note, remark, round; did you mean `cleaned`?";
    assert_eq!(
        problems,
        [
            format!("feedback: values.clened: the action vacuum declares no such feedback; {allowed}"),
            "feedback: values.round: `1.5`; the action vacuum declares a whole number".to_owned(),
        ]
    );
    let (accepted, problems) = accept("wait", &[("cleaned", Scalar::Bool(true))]);
    let undeclared = "feedback: values.cleaned: the action wait declares no such feedback; no names are available";
    assert_eq!((accepted, problems), (BTreeMap::new(), vec![undeclared.to_owned()]));
    let long = Scalar::Text("x".repeat(250));
    let (accepted, problems) = accept("vacuum", &[("note", long.clone()), ("remark", long.clone())]);
    let bytes = r#"{"note":"","remark":""}"#.len() + 500;
    let long_values = format!("feedback: values: {bytes} bytes of JSON; at most 512 are allowed");
    assert_eq!((accepted, problems), (BTreeMap::new(), vec![long_values]));
    assert_eq!(accept("vacuum", &[("note", long.clone())]), (named("note", long), vec![]));
}

#[test]
fn readings_are_accepted_in_their_declared_type() {
    let text = |text: &str| Scalar::Text(text.to_owned());
    let contract = contract();
    for (name, value, accepted) in [
        ("bag_g", Scalar::Number(2.5), Scalar::Number(2.5)),
        ("bag_g", Scalar::Integer(50), Scalar::Number(50.0)),
        ("bag_full", Scalar::Bool(true), Scalar::Bool(true)),
        ("passes", Scalar::Integer(-1), Scalar::Integer(-1)),
        ("mode", text("eco"), text("eco")),
    ] {
        assert_eq!(contract.accept_reading(name, &value), Ok(accepted));
    }
    for (name, value, expected) in [
        ("bag", Scalar::Number(1.0), "readings: values.bag: no domain declares this reading; allowed: bag_full, "),
        ("bag_g", Scalar::Number(50.5), "readings: values.bag_g: `50.5`; the domain declares a number from 0 to 50"),
        ("bag_full", Scalar::Integer(1), "readings: values.bag_full: `1`; the domain declares true or false"),
        ("passes", Scalar::Number(1.5), "readings: values.passes: `1.5`; the domain declares a whole number"),
        ("mode", text("loud"), "readings: values.mode: `loud`; the domain declares one of eco, strong"),
        ("note", text(&"x".repeat(257)), "readings: values.note: `xxx"),
    ] {
        let error = contract.accept_reading(name, &value).unwrap_err().to_string();
        assert!(error.starts_with(expected) && error.len() < 300, "{error}");
    }
}
