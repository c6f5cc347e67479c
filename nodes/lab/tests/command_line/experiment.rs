use super::support::{run, test_file};
use consort_nodes::check::{FileKind, check_file};
use consort_skills::extensions::Extensions;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A design with two trials.
const THIN: &str = r#"
name = "thin"
seed = 7
repetitions = 1
policies = ["consort", "random"]
map = "hospital"

[mission]
name = "lab-samples"
parameters = { room = "@room" }
delivered = { item = "sample", to = "lab-arm" }

[[mission.phases]]
name = "retrieve_sample"
tasks = ["navto_room", "approach_nurse", "authenticate_nurse", "open_drawer_for_nurse", "close_drawer_nurse"]

[[mission.phases]]
name = "navto_lab"
tasks = ["navto_lab", "approach_arm", "open_drawer_lab", "pick_up_sample", "close_drawer_lab"]

[[robots]]
count = 3
skills = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"]
drawer = true

[[fixed]]
name = "lab-arm"
place = "Laboratory"
skills = ["pick_up"]
role = "lab_arm"

[[people]]
name = "nurse"
role = "nurse"
place = "@room"
items = ["sample"]

[factors]
speed = { levels = 1, between = [0.5, 0.5] }
charge = { levels = 1, between = [0.9, 0.9] }
discharge = { levels = 1, between = [0.0003, 0.0003] }
skills = { lacking = [0] }

[factors.location]
levels = 1
starts = ["IC Room 1", "IC Room 3", "PC Room 1"]
sites = { room = ["IC Room 6"] }
"#;

fn folder(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("experiment").join(name)
}

fn text(folder: &Path, file: &str) -> String {
    std::fs::read_to_string(folder.join(file)).unwrap_or_else(|problem| panic!("{file}: {problem}"))
}

#[test]
fn a_design_becomes_rows_and_a_report() {
    let (design, out) = (test_file("thin.toml", THIN), folder("run"));
    let ran = run(&["experiment", "run", &design, "--out", &out.display().to_string(), "--jobs", "1"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("2 trials in "), "{}", ran.out);
    assert!(ran.err.contains("1 of 2 trials\n2 of 2 trials\n"), "{}", ran.err);
    let rows = text(&out, "rows.csv");
    assert_eq!(rows.lines().count(), 3, "{rows}");
    assert!(
        rows.contains("lab-samples/aaaaa/consort/calm/1,lab-samples,aaaaa,a,a,a,a,a,consort,calm,1,success,"),
        "{rows}"
    );
    assert!(
        text(&out, "tasks.csv")
            .starts_with("skill,from,to,predicted_s,actual_s,predicted_share,actual_share,budget_share\n")
    );
    let report = text(&out, "report.md");
    assert!(report.contains("### consort against random"));
    assert!(report.contains("| consort | calm | navto_lab | 1 | 0 | 0.0 % |"), "{report}");
    for figure in ["end-states.svg", "successes.svg", "ttc.svg"] {
        assert!(text(&out, figure).starts_with("<svg"), "{figure}");
    }
}

#[test]
fn a_calibration_is_learned_written_and_used() {
    let (design, out) = (test_file("thin-to-calibrate.toml", THIN), folder("calibrate"));
    let ran = run(&["experiment", "calibrate", &design, "--out", &out.display().to_string()]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    assert!(text(&out, "report.md").contains("## Effect of calibration"));
    let learned = out.join("calibration.toml").display().to_string();
    let again = folder("calibrated").display().to_string();
    let ran = run(&["experiment", "run", &design, "--out", &again, "--calibration", &learned]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    // A fleet file may refer to a calibration too, and its errors are reported.
    let fleet = test_file("fleet-that-learned.toml", &format!("calibration = {learned:?}\n"));
    let check = |file: &str| check_file(Path::new(file), Some(FileKind::Fleet), &[], Extensions::default());
    check(&fleet).unwrap();
    let wrong =
        test_file("wrong-calibration.toml", &std::fs::read_to_string(&learned).unwrap().replace("mean = ", "mean = -"));
    let fleet = test_file("fleet-that-learned-wrong.toml", &format!("calibration = {wrong:?}\n"));
    let problems = check(&fleet).unwrap_err().to_string();
    assert!(problems.contains(&format!("{wrong}: skills.operate_drawer: mean -")), "{problems}");
}

#[test]
fn energy_is_not_learned_from_a_file_that_is_no_recording() {
    let (file, out) = (test_file("notes.mcap", "no recording"), folder("energy"));
    let out = out.join("calibration.toml");
    let ran = run(&["experiment", "energy", &file, "--out", &out.display().to_string()]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("this is not an MCAP file") && !out.exists(), "{}", ran.err);
}

#[test]
fn flags_override_policies_treatments_and_repetitions() {
    let (design, out) = (test_file("thin-to-change.toml", THIN), folder("changed"));
    let (out_flag, calm) = (out.display().to_string(), "calm,coordinator-killed");
    let flags = ["--policies", "optimal", "--treatments", calm, "--repetitions", "2", "--seed", "8"];
    let ran = run(&[&["experiment", "run", &design, "--out", &out_flag], &flags[..]].concat());
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let rows = text(&out, "rows.csv");
    assert_eq!(rows.matches(",optimal,calm,").count(), 2, "{rows}");
    assert_eq!(rows.matches(",optimal,coordinator-killed,").count(), 2, "{rows}");
    assert!(text(&out, "report.md").contains("## With the coordinator killed"));
    let ran = run(&["experiment", "run", &design, "--out", &out_flag, "--policies", "best"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("there are: consort, mission-control, random, optimal"), "{}", ran.err);
}

#[test]
fn errors_are_reported_with_their_place_and_the_allowed_values() {
    let out = folder("never").display().to_string();
    let error = |text: &str| {
        let ran = run(&["experiment", "run", &test_file("wrong-design.toml", text), "--out", &out]);
        assert_eq!(ran.code, Some(2), "{}{}", ran.out, ran.err);
        ran.err
    };
    let unknown = error(&THIN.replace("repetitions = 1", "repetitions = 1\nrepetition = 2"));
    assert!(unknown.contains(":5:1: unknown key `repetition` in a design file; allowed: name, seed, "), "{unknown}");
    assert!(
        error(&THIN.replace("@room\"\nitems", "@rom\"\nitems"))
            .contains("there is no site @rom; did you mean \"room\"?")
    );
    assert!(
        error(&THIN.replace("IC Room 1", "IC Rom 1"))
            .contains("there is no place \"IC Rom 1\" on map hospital; did you mean")
    );
    let policy = error(&THIN.replace("\"random\"", "\"rnadom\""));
    assert!(policy.contains("`rnadom`") && policy.contains("`mission-control`"), "{policy}");
    let ran = run(&["experiment", "run", "publishd", "--out", &out]);
    assert_eq!(ran.code, Some(2));
    assert!(
        ran.err
            .contains("publishd: no such file; give the path of a file, or a bundled design: published, food, rounds"),
        "{}",
        ran.err
    );
    assert!(!Path::new(&out).exists());
}

#[test]
fn legs_prints_travel_factors_as_a_table_and_as_json() {
    let text = "origin,dest,turns,duration_s,estimate_s\nA,B,1,10,10\nA,B,1,20,10\nA,B,1,30,10\nB,L,2,50,10\n";
    let file = test_file("legs.csv", text);
    let ran = run(&["experiment", "legs", &file]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let lines = |text: &str| {
        let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
        text.lines().map(words).collect::<Vec<_>>()
    };
    assert_eq!(
        lines(&ran.out),
        [
            "from to drives 5 % median 95 %",
            "A B 3 1.10 2.00 2.90",
            "B L 1 5.00 5.00 5.00",
            "all drives 4 1.15 2.50 4.70"
        ]
    );
    let ran = run(&["experiment", "legs", &file, "--to", "L", "--json"]);
    let found: Value = serde_json::from_str(&ran.out).expect("JSON");
    assert_eq!((found["pairs"].as_array().unwrap().len(), &found["via"][0]["via"]), (0, &Value::from("B")));
    assert_eq!((&found["via"][0]["count"], &found["via"][0]["median"]), (&Value::from(4), &Value::from(2.5)));
    let ran = run(&["experiment", "legs", &file, "--to", "A"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains(&format!("{file}: no drive ends at A; drives end at: B, L")), "{}", ran.err);
}

#[test]
fn legs_reports_an_invalid_file_with_its_line() {
    let error = |text: &str| {
        let file = test_file("wrong-legs.csv", text);
        let ran = run(&["experiment", "legs", &file]);
        assert_eq!(ran.code, Some(2), "{}{}", ran.out, ran.err);
        ran.err.replace(&file, "FILE")
    };
    let header = "origin,dest,duration_s,estimate_s\n";
    let time = error(&format!("{header}A,B,2,1\nA,B,2,0\n"));
    assert!(time.contains("FILE: line 3: estimate_s is 0, allowed: a number above 0"), "{time}");
    let form = error(&format!("{header}A,B,long,1\n"));
    assert!(form.contains("FILE: ") && form.contains("line: 2"), "{form}");
    assert!(error(header).contains("FILE: the file contains no drives"));
}

/// A design with a mission and a domain of a user.
#[test]
fn a_design_of_a_domain_runs() {
    let plants = |name: &str| format!("{}/../../examples/plants/{name}", env!("CARGO_MANIFEST_DIR"));
    let begin = THIN.find("[mission]").expect("a section");
    let factors = THIN.find("[factors]").expect("a section");
    let design = format!(
        "{}[mission]\nname = \"water-plants\"\n\n[[robots]]\ncount = 3\nskills = [\"water_plant\"]\n\n{}",
        &THIN[..begin],
        THIN[factors..].replace("sites = { room = [\"IC Room 6\"] }", "")
    );
    let (design, out) = (test_file("plants.toml", &design), folder("plants").display().to_string());
    let (domain, mission) = (plants("domain.yaml"), plants("rounds.yaml"));
    let files = ["--domain", &domain, "--mission", &mission];
    let ran = run(&[&["experiment", "run", &design, "--out", &out], &files[..]].concat());
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let rows = std::fs::read_to_string(folder("plants").join("rows.csv")).expect("the rows");
    assert_eq!(rows.lines().count(), 3, "{rows}");
    assert_eq!(rows.matches(",success,").count(), 2, "{rows}");
    let ran = run(&[&["check", &design], &files[..]].concat());
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{}", ran.out);
    let ran = run(&["check", &design]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("there is no mission \"water-plants\""), "{}", ran.out);
}

#[test]
fn policies_of_a_shift_are_compared_with_the_first() {
    let flags = ["--robots", "2", "--missions", "2", "--repetitions", "2", "--policies", "instantaneous,oracle"];
    let ran = run(&[&["experiment", "shift", "--json"], &flags[..]].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let policies: Vec<Value> = ran.out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(policies.len(), 2, "{}", ran.out);
    for (figures, policy) in policies.iter().zip(["instantaneous", "oracle"]) {
        assert_eq!(figures["policy"], policy);
        assert_eq!((&figures["runs"][0]["seed"], &figures["runs"][1]["seed"]), (&Value::from(1), &Value::from(2)));
        assert_eq!(figures["runs"][1]["completed"], 2, "{figures}");
        assert!(figures["means"]["completion_s"]["interval"]["low"].is_number(), "{figures}");
    }
    assert!(policies[0]["differences"].is_null(), "{}", policies[0]);
    assert!(policies[1]["differences"]["distance_m"]["mean"].is_number(), "{}", policies[1]);
}

#[test]
fn a_shift_under_faults_checks_invariants() {
    let small = ["--robots", "4", "--missions", "4", "--per-hour", "200", "--speed", "10"];
    let faults = ["--policies", "consort", "--faults", "--json"];
    let ran = run(&[&["experiment", "shift"], &small[..], &faults].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let figures: Value = serde_json::from_str(&ran.out).expect("JSON");
    assert!(figures["violation"].is_null() && figures["faults"].is_number(), "{figures}");
    assert_eq!(figures["runs"][0]["missions"], 4, "{figures}");
    for (flags, problem) in [
        ("--faults", "--faults needs --policies consort"),
        ("--faults --policies consort", "--speed 1 with --faults; at least 2 is needed"),
        ("--faults --policies consort --speed 2 --robots 21", "--robots 21 with --faults; at most 20 are allowed"),
        ("--faults --policies consort --speed 2 --arms 4", "--arms 4 with --faults; at most 3 are allowed"),
        ("--faults --policies consort --speed 2", "--faults needs a rate of requests: --per-hour or --load"),
    ] {
        let flags: Vec<&str> = ["experiment", "shift"].into_iter().chain(flags.split(' ')).collect();
        let ran = run(&flags);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{flags:?}: {}", ran.err);
        assert!(ran.err.contains(problem), "{flags:?}: {}", ran.err);
    }
}

#[test]
fn hours_of_a_shift_need_a_rate() {
    let ran = run(&["experiment", "shift", "--hours", "1"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(ran.err.contains("--hours needs a rate of requests: --per-hour or --load"), "{}", ran.err);
    let ran = run(&["experiment", "shift", "--load", "70"]);
    assert!(ran.err.contains("\"70\", allowed is a number from 0.01 to 2"), "{}", ran.err);
}
