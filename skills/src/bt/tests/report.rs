//! The report on the nodes of a description.

use super::super::xml::read_xml;
use super::*;

/// A tree of the shape of Nav2's navigator: planning at 1 Hz while the robot follows the path, with
/// recoveries for each part and for the whole.
const NAVIGATOR: &str = r#"<root BTCPP_format="4" main_tree_to_execute="Navigate">
  <BehaviorTree ID="Navigate">
    <RecoveryNode number_of_retries="6" name="navigation with recovery">
      <PipelineSequence name="plan and follow">
        <RateController hz="1.0">
          <RecoveryNode number_of_retries="1" name="plan">
            <ComputePathToPose goal="{goal}" path="{path}" planner_id="GridBased" error_code_id="{plan_error}"/>
            <ClearEntireCostmap name="clear global costmap" service_name="global_costmap/clear_entirely_global_costmap"/>
          </RecoveryNode>
        </RateController>
        <RecoveryNode number_of_retries="1" name="follow">
          <FollowPath path="{path}" controller_id="FollowPath" error_code_id="{follow_error}"/>
          <Action ID="ClearEntireCostmap" service_name="local_costmap/clear_entirely_local_costmap"/>
        </RecoveryNode>
      </PipelineSequence>
      <ReactiveFallback name="recover unless there is another goal">
        <GoalUpdated/>
        <Fallbak>
          <SubTree ID="Recoverys" tries="{tries}"/>
          <SubTree ID="Recoveries" _skipIf="tries > 3"/>
        </Fallbak>
      </ReactiveFallback>
    </RecoveryNode>
  </BehaviorTree>
  <BehaviorTree ID="Recoveries">
    <RoundRobin name="one after the other">
      <Sequence>
        <ClearEntireCostmap service_name="local_costmap/clear_entirely_local_costmap"/>
      </Sequence>
      <Spin spin_dist="1.57"/>
      <Wait wait_duration="5.0"/>
      <Control ID="BackUp" backup_dist="0.30" backup_speed="0.15"/>
    </RoundRobin>
  </BehaviorTree>
</root>"#;

fn with_wait() -> Registry<CallLog> {
    let mut registry = registry();
    let ports = [PortSpec::input("wait_duration", PortType::Seconds)];
    registry.register_condition("Wait", ports, |_| Ok(true)).unwrap();
    registry
}

#[test]
fn every_node_of_a_navigator_is_reported() {
    let spec = read_xml("navigate.xml", NAVIGATOR).unwrap();
    let reports = report_nodes(&spec, &with_wait());
    let lines = reports.iter().map(|node| {
        let origin = match &node.origin {
            NodeOrigin::BuiltIn => "built in".to_owned(),
            NodeOrigin::Registered => "registered".to_owned(),
            NodeOrigin::Tree => "tree".to_owned(),
            NodeOrigin::Unknown { nearest: None } => "unknown".to_owned(),
            NodeOrigin::Unknown { nearest: Some(name) } => format!("unknown, near {name}"),
        };
        let kind = node.kind.map_or("-".to_owned(), |kind| format!("{kind:?}"));
        format!("{}:{} {} {kind} {origin}", node.tree, node.line.unwrap(), node.id)
    });
    let expected = "\
        Navigate:3 RecoveryNode - unknown
        Navigate:4 PipelineSequence - unknown
        Navigate:5 RateController - unknown
        Navigate:6 RecoveryNode - unknown
        Navigate:7 ComputePathToPose - unknown
        Navigate:8 ClearEntireCostmap - unknown
        Navigate:11 RecoveryNode - unknown
        Navigate:12 FollowPath - unknown
        Navigate:13 ClearEntireCostmap Action unknown
        Navigate:16 ReactiveFallback Control built in
        Navigate:17 GoalUpdated - unknown
        Navigate:18 Fallbak - unknown, near Fallback
        Navigate:19 Recoverys SubTree unknown, near Recoveries
        Navigate:20 Recoveries SubTree tree
        Recoveries:26 RoundRobin - unknown
        Recoveries:27 Sequence Control built in
        Recoveries:28 ClearEntireCostmap - unknown
        Recoveries:30 Spin - unknown
        Recoveries:31 Wait Condition registered
        Recoveries:32 BackUp Control unknown";
    let expected: Vec<&str> = expected.lines().map(str::trim).collect();
    assert_eq!(lines.collect::<Vec<_>>(), expected);
    assert_eq!(reports[0].name.as_deref(), Some("navigation with recovery"));
}

#[test]
fn a_tree_with_unknown_nodes_is_not_executed() {
    let spec = read_xml("navigate.xml", NAVIGATOR).unwrap();
    let error = with_wait().check(&spec).err().unwrap().to_string();
    let expected =
        "navigate.xml:3: Navigate/RecoveryNode (navigation with recovery): there is no node `RecoveryNode`; known are ";
    assert!(error.starts_with(expected), "{error}");
}
