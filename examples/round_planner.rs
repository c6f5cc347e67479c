//! A planner that divides rooms among robots and writes the mission.
//! `round_planner MAP.json PLAN.json ROBOTS ROOM...`

use serde_json::{Value, json};
use std::error::Error;

/// Returns the position of a place on a map in Consort's own format.
fn place(map: &Value, name: &str) -> Option<(f64, f64)> {
    let place = map["places"].as_array()?.iter().find(|place| place["name"] == name)?;
    Some((place["x_m"].as_f64()?, place["y_m"].as_f64()?))
}

/// Sorts the rooms from west to east and divides them into equal stretches, a role for each robot.
fn plan(map: &Value, robots: usize, rooms: &[String]) -> Result<Value, Box<dyn Error>> {
    let east = |room: &str| place(map, room).map(|(x, _)| x).ok_or(format!("{room} is not on the map"));
    let mut rooms = rooms.iter().map(|room| Ok((east(room)?, room))).collect::<Result<Vec<_>, Box<dyn Error>>>()?;
    rooms.sort_by(|a, b| a.0.total_cmp(&b.0));
    let stretches: Vec<_> = rooms.chunks(rooms.len().div_ceil(robots.max(1)).max(1)).collect();
    let (roles, rounds): (serde_json::Map<String, Value>, Vec<Value>) = (1..).zip(&stretches).map(round).unzip();
    Ok(json!({
        "mission": "rounds",
        "title": format!("{} rooms, planned for {} robots", rooms.len(), stretches.len()),
        "roles": roles,
        "root": { "task": "all_rounds", "method": "unordered", "tasks": rounds },
    }))
}

/// Returns the role with this number and the task that visits its rooms.
fn round((number, rooms): (usize, &&[(f64, &String)])) -> ((String, Value), Value) {
    let role = format!("r{number}");
    let look_in = |(visit, (_, room)): (usize, &(f64, &String))| {
        let (task, to) = (format!("go_{number}_{visit}"), json!({ "to": room }));
        json!({ "task": task, "type": "navigation", "roles": [role], "parameters": to, "reaches": { "location": room } })
    };
    let visits: Vec<Value> = (1..).zip(rooms.iter()).map(look_in).collect();
    let round = json!({ "task": format!("round_{number}"), "method": "sequential", "tasks": visits });
    ((role, json!({ "kind": "managed" })), round)
}

pub(crate) fn run(args: &[String]) -> Result<(), Box<dyn Error>> {
    let [map, out, robots, rooms @ ..] = args else { return Err("MAP.json PLAN.json ROBOTS ROOM...".into()) };
    let map = serde_json::from_str(&std::fs::read_to_string(map)?)?;
    let mission = plan(&map, robots.parse()?, rooms)?;
    Ok(std::fs::write(out, serde_json::to_string_pretty(&mission)?)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&std::env::args().skip(1).collect::<Vec<_>>())
}
