use super::support::{command, crate_file, run, test_file};
use std::path::PathBuf;

fn sample(name: &str) -> String {
    crate_file(&format!("../../sim_bridge/map_import/maps/{name}"))
}

/// Returns an empty folder of a test.
fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("command_line").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    folder
}

#[test]
fn check_summarizes_maps_of_every_format_and_lists_omissions() {
    let (clinic, office) = (sample("clinic.drawio"), sample("office.building.yaml"));
    let ran = run(&["map", "check", "hospital", &clinic, &office]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    for expected in [
        "hospital: ok, hospital: 1 level, 32 places, 31 lanes".to_owned(),
        format!("{clinic}: ok, clinic: 1 level, 11 places, 11 lanes, 1 door, 1 robot, 1 object, 1 person"),
        format!(
            "{office}: note: the lanes belong to graphs 0, 1; the file of a robot names its graph, as `graph = \"0\"`"
        ),
        format!(
            "{office}: note: place \"base\" is at a dead end: on the 2 lanes from \"L1 vertex 5\" (20.0 m) no two robots can pass each other"
        ),
        format!("{office}: ok, office: 2 levels, 12 places, 10 lanes, 2 doors, 1 lift, 1 robot"),
    ] {
        assert!(ran.out.lines().any(|line| line == expected), "{expected:?} is missing in\n{}", ran.out);
    }
}

#[test]
fn check_reports_all_map_errors_with_file_and_place() {
    let office = std::fs::read_to_string(sample("office.building.yaml")).expect("the sample");
    let wrong = test_file("wrong.building.yaml", &office.replace("- [6, 7, { bid", "- [6, 17, { bid"));
    let ran = run(&["map", "check", &wrong, "hospital"]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    let expected = format!("{wrong}: level \"L2\", lane 3: there is no vertex 17; allowed are 0 to 7\n");
    assert!(ran.out.starts_with(&expected), "{}", ran.out);
    assert!(ran.err.contains("problems in 1 of 2 maps"), "{}", ran.err);
    let missing = run(&["map", "show", "ward.drawio"]);
    assert_eq!(missing.code, Some(2));
    assert!(
        missing.err.contains("ward.drawio: this map cannot be read: ")
            && missing.err.contains("a bundled map: hospital"),
        "{}",
        missing.err
    );
}

#[test]
fn show_draws_to_the_current_folder_the_output_or_a_file() {
    let folder = folder("show");
    let office = sample("office.building.yaml");
    let ran = command(&["map", "show", &office]).current_dir(&folder).output().expect("the binary starts");
    assert!(ran.status.success(), "{ran:?}");
    let svg = std::fs::read_to_string(folder.join("office.svg")).expect("the picture");
    assert!(svg.starts_with("<svg ") && svg.contains("reception"), "{svg}");
    let out = run(&["map", "show", &office, "--out", "-"]);
    assert_eq!((out.code, out.out.trim_end()), (Some(0), svg.trim_end()));
    let png = folder.join("clinic.PNG");
    let ran = run(&["map", "show", &sample("clinic.drawio"), "--out", &png.display().to_string()]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(std::fs::read(&png).expect("the picture").starts_with(b"\x89PNG\r\n"), "no PNG");
    let ran = run(&["map", "show", "hospital", "--out", "/nowhere/at/all.svg"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("/nowhere/at/all.svg cannot be written"), "{}", ran.err);
}

#[test]
fn convert_writes_an_equivalent_map_in_our_format() {
    let folder = folder("convert");
    let clinic = sample("clinic.drawio");
    for name in ["clinic.yaml", "clinic.json"] {
        let out = folder.join(name).display().to_string();
        let ran = run(&["map", "convert", &clinic, "--to", "ours", "--out", &out]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{}", ran.err);
        assert!(
            ran.err.contains("a map holds no robot: \"Ada\" at (2, 4.4) m, near \"Robot Home\" is left out"),
            "{}",
            ran.err
        );
        let checked = run(&["map", "check", &out]);
        let expected = format!("{out}: ok, clinic: 1 level, 11 places, 11 lanes, 1 door\n");
        assert!(checked.out.ends_with(&expected), "{}{}", checked.out, checked.err);
    }
    let text = run(&["map", "convert", &clinic, "--scale", "0.04"]).out;
    let near = run(&["map", "convert", &clinic]).out;
    assert!(near.starts_with("name: clinic\n") && near.contains("x_m: 3.6") && text.contains("x_m: 7.2"), "{near}");
    let ran = run(&["map", "convert", &clinic, "--scale", "0"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("allowed is a number from 0.000001 to 1000000"), "{}", ran.err);
    let ran = run(&["map", "convert", &sample("office.building.yaml"), "--graph", "3"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("graph 3 has no lanes; graphs with lanes: 0, 1"), "{}", ran.err);
}

#[test]
fn drawn_robots_people_and_items_become_a_world() {
    let folder = folder("drawn_world");
    let [map, world] = ["clinic.yaml", "clinic.toml"].map(|name| folder.join(name).display().to_string());
    let ran = run(&["map", "convert", &sample("clinic.drawio"), "--out", &map, "--world", &world]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{}", ran.err);
    assert!(ran.err.contains("speed, battery and discharge of robots are not drawn: 0.5 m/s, full"), "{}", ran.err);
    assert!(!ran.err.contains("left out"), "{}", ran.err);
    let checked = run(&["check", &world]);
    assert_eq!(checked.out, format!("{world}: ok, a world: 1 robot, 1 person\n"), "{}", checked.err);
    let text = std::fs::read_to_string(&world).expect("a world file");
    for line in [
        "map = \"clinic.yaml\"",
        "id = \"ada\"",
        "place = \"Robot Home\"",
        "has_arm = true",
        "name = \"Bea\"",
        "role = \"nurse\"",
        "name = \"sample\"",
        "weight_kg = 0.2",
    ] {
        assert!(text.contains(line), "{line} is missing in\n{text}");
    }
    let ran = run(&["map", "convert", &sample("clinic.drawio"), "--world", &world]);
    assert_eq!(ran.code, Some(2), "a world needs a map to be on: {}", ran.out);
}

#[test]
fn a_map_of_any_format_is_accepted_everywhere() {
    let (clinic, office) = (sample("clinic.drawio"), sample("office.building.yaml"));
    let world = |map: &str, place: &str| {
        format!(
            "map = {map:?}\n[fleet]\nmap = {map:?}\n[[robot]]\nid = \"ada\"\nplace = {place:?}\n\
             speed_mps = 1.0\nbattery = 0.9\ndischarge_share_per_s = 0.0002\n"
        )
    };
    let a = test_file("drawn_world.toml", &world(&clinic, "Ward 1"));
    let b = test_file("built_world.toml", &world(&office, "meeting"));
    let ran = run(&["check", &a, &b, &clinic, &office]);
    let expected = format!(
        "{a}: ok, a world: 1 robot, 0 people\n{b}: ok, a world: 1 robot, 0 people\n\
         {clinic}: ok, a map: 11 places, 11 ways\n{office}: ok, a map: 12 places, 11 ways\n"
    );
    assert_eq!((ran.code, ran.out), (Some(0), expected), "{}", ran.err);
    let wrong = test_file("drawn_wrong.toml", &world(&clinic, "Ward 3"));
    let ran = run(&["check", &wrong]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.out.contains("\"Ward 3\""), "{}", ran.out);
}

#[test]
fn a_robot_drives_on_a_navigation_graph_of_the_map() {
    let office = sample("office.building.yaml");
    let robot = |graph: &str| {
        format!(
            "name = \"crane\"\nplace = \"crane_a\"\ngraph = {graph:?}\nskills = [\"navigation\"]\nspeed_mps = 1.0\n\
             [fleet]\nmap = {office:?}\n"
        )
    };
    let (good, wrong) = (test_file("crane.toml", &robot("1")), test_file("wrong_crane.toml", &robot("7")));
    let ran = run(&["check", &good]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let ran = run(&["check", &wrong]);
    assert_eq!(ran.code, Some(1));
    let expected = "graph: \"7\" is not a navigation graph of the fleet's map; allowed: 0, 1";
    assert!(ran.out.contains(expected), "{}", ran.out);
}
