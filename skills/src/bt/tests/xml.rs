//! Trees as files.

use super::super::xml::read::MAX_BYTES;
use super::super::xml::{read_xml, write_xml};
use super::*;

fn read_error(text: &str) -> String {
    match read_xml("t.xml", text).and_then(|spec| registry().check(&spec).map(|_| ())) {
        Ok(()) => panic!("it was accepted"),
        Err(error) => error.to_string(),
    }
}

/// Returns a file with a single tree.
fn file(nodes: &str) -> String {
    format!("<root BTCPP_format=\"4\">\n<BehaviorTree ID=\"main\">\n{nodes}\n</BehaviorTree></root>")
}

const BOTH_FORMS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<root BTCPP_format="4" main_tree_to_execute="main">
  <!-- compact and explicit forms -->
  <BehaviorTree ID="main">
    <Control ID="Sequence" name="all of it">
      <Action ID="Copy" value="Home" to="{here}"/>
      <Condition ID="IsHome" place="{here}"/>
      <Decorator ID="Inverter"><Inverter><Play as="a" plays="RS" _uid="7"/></Inverter></Decorator>
      <SubTree ID="sub" _autoremap="true" where="{here}" _skipIf="here != 'Home'" _onFailure="n := 1"/>
      <Script code="n := 1 &lt; 2 &amp;&amp; true ? 1 : 0"/>
    </Control>
  </BehaviorTree>
  <BehaviorTree ID="sub"><IsHome place="{where}"/></BehaviorTree>
  <TreeNodesModel><Action ID="Play"/></TreeNodesModel>
</root>"#;

#[test]
fn compact_and_explicit_forms_are_read() {
    let mut stage = TreeFixture::from_spec(&read_xml("t.xml", BOTH_FORMS).unwrap());
    stage.expect(&[('R', "a"), ('S', "a")]);
}

#[test]
fn the_model_of_a_sub_tree_has_defaults_for_its_ports() {
    let text = |ports| {
        format!(
            "<root BTCPP_format=\"4\" main_tree_to_execute=\"main\">
            <TreeNodesModel><SubTree ID=\"sub\">
                <input_port name=\"where\" default=\"Home\"/><output_port name=\"to\" default=\"{{copied}}\"/>
            </SubTree></TreeNodesModel>
            <BehaviorTree ID=\"main\"><Sequence><SubTree ID=\"sub\" {ports}/></Sequence></BehaviorTree>
            <BehaviorTree ID=\"sub\"><Copy value=\"{{where}}\" to=\"{{to}}\"/></BehaviorTree></root>"
        )
    };
    let copied = |ports, key| {
        let mut stage = TreeFixture::from_spec(&read_xml("t.xml", &text(ports)).unwrap());
        stage.expect(&[('S', "")]);
        stage.tree.get::<String>(key).unwrap().unwrap()
    };
    assert_eq!(copied("", "copied"), "Home");
    assert_eq!(copied("where=\"Away\"", "copied"), "Away");
    assert_eq!(copied("to=\"{=}\"", "to"), "Home");
    let autoremap = read_xml("t.xml", &text("_autoremap=\"1\"")).unwrap();
    assert_eq!(registry().check(&autoremap).ok().unwrap().inputs()[0].key, "where");
}

#[test]
fn a_written_tree_is_read_back() {
    fn without_lines(node: &mut NodeSpec) {
        node.line = None;
        node.children.iter_mut().for_each(without_lines);
    }
    let mut spec = read_xml("t.xml", BOTH_FORMS).unwrap();
    let awkward = play("a<b>&\"c\"\n\t", "S").named("it's <so>");
    spec = spec.with("awkward", awkward);
    let written = write_xml(&spec, &registry());
    let mut again = read_xml("t.xml", &written).unwrap_or_else(|error| panic!("{error}\n{written}"));
    for tree in spec.trees.values_mut().chain(again.trees.values_mut()) {
        without_lines(tree);
    }
    assert_eq!(again, spec, "{written}");
    let model = "    <Action ID=\"Copy\">\n      <input_port name=\"value\" type=\"any\"/>\n      <output_port name=\"to\" type=\"any\"/>\n    </Action>\n    <Condition ID=\"IsHome\">";
    assert!(written.contains(model), "{written}");
}

#[test]
fn mistakes_name_file_line_and_node() {
    assert_eq!(
        read_error(&file("<Sequence>\n<IsHome/></Sequence>")),
        "t.xml:4: main/IsHome: port `place` (a place) is missing"
    );
    for (nodes, expected) in [
        ("<Action/>", "t.xml:3: <Action> needs an ID"),
        ("<Play ID=\"Play\"/>", "t.xml:3: <Play> takes no ID: its kind is its tag"),
        ("<AlwaysSuccess/><AlwaysSuccess/>", "t.xml:2: tree `main` has 2 root nodes; allowed is 1"),
        ("<Sequence>hello</Sequence>", "t.xml:3: <Sequence> contains the text \"hello\"; allowed are nodes only"),
        (
            "<AlwaysSuccess _skip=\"x\"/>",
            "t.xml:3: <AlwaysSuccess> has no attribute `_skip`; allowed are its ports and _failureIf, _successIf, _skipIf, \
             _while, _onSuccess, _onFailure, _onHalted, _post",
        ),
        (
            "<AlwaysSuccess\n_skipIf=\"1 +\"/>",
            "t.xml:3: main/AlwaysSuccess: script `_skipIf`: `1 +`: Syntax error: mismatched input '<EOF>' expecting \
             {'[', '{', '(', '.', '-', '!', 'true', 'false', 'null', NUM_FLOAT, NUM_INT, NUM_UINT, STRING, BYTES, IDENTIFIER}",
        ),
        ("<SubTree ID=\"x\" _autoremap=\"maybe\"/>", "t.xml:3: _autoremap is \"maybe\"; allowed are true and false"),
    ] {
        assert_eq!(read_error(&file(nodes)), expected);
    }
}

#[test]
fn a_text_that_is_not_a_tree_file_is_rejected() {
    for (text, expected) in [
        ("<tree/>", "t.xml:1: the file begins with <tree>, not <root>"),
        ("<root/>", "t.xml:1: BTCPP_format is missing; supported is \"4\""),
        ("<root BTCPP_format=\"3\"/>", "t.xml:1: BTCPP_format is \"3\"; supported is \"4\""),
        ("<root BTCPP_format=\"4\"/>", "t.xml:1: there is no <BehaviorTree>"),
        (
            "<root BTCPP_format=\"4\">\n<include path=\"x\"/></root>",
            "t.xml:2: <include> is not allowed in <root>; allowed are <BehaviorTree> and <TreeNodesModel>",
        ),
    ] {
        assert_eq!(read_error(text), expected);
    }
    let tree = "<BehaviorTree ID=\"a\"><AlwaysSuccess/></BehaviorTree>";
    let two = format!("<root BTCPP_format=\"4\">{tree}{tree}</root>");
    assert_eq!(read_error(&two), "t.xml:1: there are two trees `a`");
    let other = tree.replace("\"a\"", "\"b\"");
    let unclear = format!("<root BTCPP_format=\"4\">{tree}{other}</root>");
    assert_eq!(read_error(&unclear), "t.xml:1: main_tree_to_execute is missing; the trees are a, b");
    assert!(
        read_error("<root BTCPP_format=\"4\">\n<a></b></root>").starts_with("t.xml:2: the text is not valid XML: ")
    );
}

#[test]
fn hostile_files_are_rejected() {
    let bomb = "<!DOCTYPE r [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;\">]><root BTCPP_format=\"4\">&b;</root>";
    assert!(read_error(bomb).contains("not valid XML"), "{}", read_error(bomb));
    let deep = format!("{}{}", "<Inverter>".repeat(20_000), "</Inverter>".repeat(20_000));
    assert!(read_error(&file(&deep)).ends_with("it is nested deeper than 100 levels, sub-trees included"));
    let deeper = "<a>".repeat(MAX_BYTES / 3);
    assert!(read_error(&deeper).contains("not valid XML"));
    let large = file(&format!("<!--{}-->", " ".repeat(MAX_BYTES)));
    assert!(read_error(&large).contains("bytes; allowed are at most 1048576"));
    let wide = file(&format!("<Sequence>{}</Sequence>", "<AlwaysSuccess/>".repeat(11_000)));
    assert!(read_error(&wide).contains("more than 10000 nodes"), "{}", read_error(&wide));
}

proptest::proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(parts in proptest::collection::vec(0usize..12, 0..40)) {
        let pieces = [
            "<root BTCPP_format=\"4\">", "</root>", "<BehaviorTree ID=\"a\">", "</BehaviorTree>", "<Sequence>", "</Sequence>",
            "<IsHome place=\"{x}\"/>", "<SubTree ID=\"a\"/>", "{", "<Play as=\"a\" plays=\"{=}\"/>", "&lt;", "<Copy value=\"{}\" to=\"{x}\"/>",
        ];
        let text: String = parts.into_iter().map(|part| pieces[part]).collect();
        let _ = read_xml("t.xml", &text).and_then(|spec| registry().check(&spec).map(|_| ()));
    }
}
