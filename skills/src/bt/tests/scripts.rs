//! The script language, in `Script` and `ScriptCondition` nodes.

use super::*;

fn script(code: &str) -> NodeSpec {
    NodeSpec::new("Script").port("code", code)
}

fn condition(code: &str) -> NodeSpec {
    NodeSpec::new("ScriptCondition").port("code", code)
}

fn main(root: NodeSpec) -> TreeSpec {
    TreeSpec::single("main", root)
}

/// Executes a script and returns `{x}`.
fn x_after(code: &str) -> Value {
    let mut stage = TreeFixture::from_root(script(code));
    assert_eq!(stage.tick().0, 'S', "{code}: {:?}", stage.tree.cause());
    stage.tree.get("x").unwrap().unwrap_or_else(|| panic!("{code} writes no x"))
}

/// Executes a script that fails and returns the cause.
fn cause_of(code: &str) -> String {
    let mut stage = TreeFixture::from_root(script(code));
    assert_eq!(stage.tick().0, 'F', "{code}");
    stage.tree.cause().unwrap().text.clone()
}

#[test]
fn arithmetic_uses_doubles_only() {
    for (code, expected) in [
        ("x := 1 + 2 * 3", 7.0),
        ("x := 7 / 2", 3.5),
        ("x := 1 / 4 + 0.5", 0.75),
        ("x := 0.5 + 1", 1.5),
        ("x := 2 - -3", 5.0),
        ("x := -(1 + 1.5)", -2.5),
        ("a := 3; b := a / 2; x := a + b", 4.5),
        ("x := 10; x += 1; x -= 3; x *= 2; x /= 4 + 4", 2.0),
        ("x := true ? 1 : 2.5", 1.0),
        ("x := 1 > 2 ? 1 : 3 >= 3.0 ? 2 : 3", 2.0),
        ("x := 1; x = x + 0.5; ; ", 1.5),
    ] {
        assert_eq!(x_after(code), Value::Number(expected), "{code}");
    }
}

#[test]
fn texts_may_contain_the_tokens_of_scripts() {
    for (code, expected) in [
        ("x := 'a;b := c'", "a;b := c"),
        ("x := 'a' + '=' + 'b'; x += '//'", "a=b//"),
        (r"x := 'it\'s'", "it's"),
        ("x := '\"'", "\""),
    ] {
        assert_eq!(x_after(code), Value::from(expected), "{code}");
    }
}

#[test]
fn comparisons_convert_texts() {
    for (code, expected) in [
        ("x := 1 == 1.0 && 2 != 3 && 1 < 1.5 && 2 <= 2 && 3 > 2.5 && 3 >= 3", true),
        ("x := 'a' < 'b' && 'a' != 'b' && 'a' == 'a'", true),
        ("x := '3' == 3 && 3 == '3.0' && '10' > 9", true),
        ("x := 'true' == true && true != 'false'", true),
        ("x := true == 1 && false < 1", true),
        ("x := !(1 == 2) && !false", true),
        ("x := false || 1 == 2", false),
        ("x := true || 1 == 2 && false", true),
    ] {
        assert_eq!(x_after(code), Value::Bool(expected), "{code}");
    }
}

#[test]
fn the_right_operand_is_evaluated_only_if_needed() {
    let stored = "a := 'no number'; ";
    for (code, expected) in [("x := false && a > 1", false), ("x := true || a > 1", true)] {
        assert_eq!(x_after(&format!("{stored}{code}")), Value::Bool(expected));
    }
    for code in ["x := a > 1 && false", "x := a > 1 || true", "x := true && 1", "x := 1 || true"] {
        cause_of(&format!("{stored}{code}"));
    }
}

#[test]
fn a_failing_script_is_reported_with_its_place() {
    for (code, expected) in [
        ("x := 1 / 0", "`x := 1 / 0`: it evaluates to inf; allowed is a finite number"),
        ("x := 'a' > 1", "`x := 'a' > 1`: \"a\" is not a number: allowed is a finite number such as 2.5"),
        ("x := true + 1", "`x := true + 1`: Unsupported binary operator 'add': Bool(true), Float(1.0)"),
        ("x := y; y := 1", "`x := y`: {y} is empty"),
        ("x = 1; x := 1", "`x = 1`: {x} is empty"),
        ("x += 1; x := 1", "`x += 1`: {x} is empty"),
    ] {
        assert_eq!(cause_of(code), format!("main: main/Script: script `code`: {expected}"));
    }
}

#[test]
fn syntax_errors_are_reported_when_the_tree_is_checked() {
    for (code, expected) in [
        ("", "it is empty; allowed are statements separated by `;`"),
        (" ; ", "it is empty; allowed are statements separated by `;`"),
        ("x := 'a", "`'` is not allowed here; a text ends with another `'`"),
        ("x := \"a\"", "`\"` is not allowed here; a text is enclosed in single quotes: 'text'"),
        ("x := 1 // one", "`//` is not allowed here; a script has no comments"),
        ("1 := 2", "`1` cannot be assigned; allowed is a name of letters, digits and `_`, such as `count`"),
        ("a b = 2", "`a b` cannot be assigned; allowed is a name of letters, digits and `_`, such as `count`"),
    ] {
        assert_eq!(check_error(&main(script(code))), format!("main: main/Script: script `code`: {expected}"));
    }
    let rejected = |code| check_error(&main(script(code)));
    for code in ["x := ", "x := 1 +", "x := (1", "x := 1 2", "x := y := 1", "{x}", "x := 1; y := *"] {
        let error = rejected(code);
        assert!(error.starts_with("main: main/Script: script `code`: `"), "{code}: {error}");
    }
    for (code, found) in [
        ("x := size('a')", "the call of `size`"),
        ("x := 'a'.size()", "the call of `size`"),
        ("x := compare(1, 2)", "the call of `compare`"),
        ("x := 5 % 2", "the operator `%`"),
        ("x := [1]", "a list"),
        ("x := [1].all(a, a == 1)", "a loop over a list"),
        ("x := a.b", "the field `.b`"),
        ("x := null", "null"),
        ("x := 1u", "a number that ends with u"),
    ] {
        let error = rejected(code);
        assert!(error.contains(&format!("{found} is not allowed; allowed are names, numbers, 'texts'")), "{error}");
    }
    let long = format!("x := {}1", "1 + ".repeat(1100));
    assert!(rejected(&long).ends_with("it has 4406 bytes; allowed are at most 4096"));
}

#[test]
fn hostile_scripts_are_rejected() {
    let enclosed =
        |open: &str, close: &str, times: usize| script(&format!("x := {}1{}", open.repeat(times), close.repeat(times)));
    for node in [
        enclosed("(", ")", 2000),
        enclosed("1 + ", "", 1000),
        enclosed("1 ? ", " : 1", 500),
        enclosed("1 < ", "", 1000),
    ] {
        let error = check_error(&main(node));
        assert!(error.starts_with("main: main/Script: script `code`: `"), "{error}");
    }
    // The parser reduces repeated signs.
    for node in [enclosed("- ", "", 2000), enclosed("!", "", 4000)] {
        TreeFixture::from_root(node).tick();
    }
    assert_eq!(x_after(&format!("x := {}1", "1 + ".repeat(60))), Value::Number(61.0));
    let cause = cause_of(&format!("x := 'a'; {}", "x += x; ".repeat(100)));
    assert!(cause.ends_with("`x += x`: it evaluates to a text of 8192 bytes; allowed are at most 4096"), "{cause}");
}

#[test]
fn a_condition_is_true_or_false() {
    TreeFixture::from_root(sequence([script("x := 1"), condition("x == 1")])).expect(&[('S', "")]);
    let mut stage = TreeFixture::from_root(condition("x := 1; x == 2").named("is two"));
    stage.expect(&[('F', "")]);
    assert_eq!(stage.tree.cause().unwrap().text, "is two: the condition is false");
    let mut stage = TreeFixture::from_root(inverter(condition("1 + 1")));
    stage.expect(&[('F', "")]);
    let expected = "main: main/ScriptCondition: script `code`: `1 + 1`: \"2\" is not true or false: it is a number";
    assert_eq!(stage.tree.cause().unwrap().text, expected);
    let expected = "main: main/ScriptCondition: script `code`: the condition ends with the assignment to `x`; \
                    allowed is an expression (`==` compares)";
    assert_eq!(check_error(&main(condition("x = 1"))), expected);
}

#[test]
fn an_error_ends_the_tree_and_halts_what_runs() {
    let broken = || sequence([play("a", "RS"), condition("'text' > 1")]);
    let root = || NodeSpec::new("ForceSuccess").child(fallback([broken(), play("b", "S")]));
    let mut stage = TreeFixture::from_root(parallel(3, [play("c", "R"), root(), play("d", "R")]));
    stage.expect(&[('R', "c a d"), ('F', "c a c! d!"), ('F', "c a c!")]);
    let broken = NodeSpec::new("ForceSuccess").child(condition("'text' > 1"));
    let endless = NodeSpec::new("Repeat").port("num_cycles", "-1").child(broken);
    TreeFixture::from_root(parallel(2, [play("a", "R"), endless])).expect(&[('F', "a a!")]);
}

#[test]
fn keys_are_shared_with_ports_and_typed() {
    let retry = NodeSpec::new("RetryUntilSuccessful").port("num_attempts", "{attempts}").child(play("a", "F"));
    TreeFixture::from_root(sequence([script("attempts := 1; attempts += 1"), retry])).expect(&[('F', "a a")]);
    let sleep = || NodeSpec::new("Sleep").port("msec", "{msec}");
    let mut stage = TreeFixture::from_root(sequence([script("msec := 1.5"), sleep()]));
    stage.expect(&[('F', "")]);
    let expected =
        "main: main/Script: script `code`: `msec := 1.5`: {msec}: \"1.5\" is not a whole number: it is a number";
    assert_eq!(stage.tree.cause().unwrap().text, expected);
    let copy = NodeSpec::new("Copy").port("value", "Home").port("to", "{here}");
    let is_home = NodeSpec::new("IsHome").port("place", "{here}");
    TreeFixture::from_root(sequence([copy, condition("here == 'Home'"), is_home])).expect(&[('S', "")]);
}

#[test]
fn keys_that_nothing_writes_are_reported() {
    let spec = |root| main(NodeSpec::subtree("sub")).with("sub", root);
    let error = |root| check_error(&spec(root));
    assert_eq!(
        error(condition("x > 1")),
        "main: sub/ScriptCondition: `code` reads {x}, which is neither written nor passed to the sub-tree"
    );
    assert!(error(script("x = 1")).contains("`code` reads {x}, which is neither written"));
    assert!(error(script("x += 1")).contains("`code` reads {x}, which is neither written"));
    TreeFixture::from_spec(&spec(script("x := 1; x = 2")));
}

#[test]
fn a_key_of_the_main_tree_that_nothing_writes_is_its_input() {
    let blueprint = registry().check(&main(condition("limit > 1"))).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(blueprint.inputs(), [TreeInput { key: "limit".to_owned(), port_type: PortType::Any, required: true }]);
    let mut tree = blueprint.instantiate(&CallLog::default());
    tree.set("limit", "2").unwrap();
    assert_eq!(tree.tick(&mut NoRobot, WorldTime::ZERO), NodeStatus::Success);
}

proptest::proptest! {
    #[test]
    fn mixed_arithmetic_equals_that_of_doubles(a in -999_i32..1000, b in 1_i32..1000, c in -1e6_f64..1e6) {
        let (x, y) = (f64::from(a), f64::from(b));
        let expected = (x + c) * y - x / y;
        proptest::prop_assert_eq!(x_after(&format!("c := {c:?}; x := ({a} + c) * {b} - {a} / {b}")), Value::Number(expected));
    }

    #[test]
    fn no_text_makes_the_compiler_panic(parts in proptest::collection::vec(0usize..24, 0..30)) {
        let pieces = [
            "x", ":=", "=", "+=", "==", "1", ";", "'", "(", ")", "&&", "!", "?", ":", "-", " ", "'a'", "/", ".", "é",
            "true", "<", "\\", "size(",
        ];
        let text: String = parts.into_iter().map(|part| pieces[part]).collect();
        let spec = TreeSpec::single("main", NodeSpec::new("Script").port("code", &text));
        if let Ok(blueprint) = registry().check(&spec) {
            let _ = blueprint.instantiate(&CallLog::default()).tick(&mut NoRobot, WorldTime::ZERO);
        }
    }
}
