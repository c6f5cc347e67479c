//! Routes of the dashboard's server.

use super::forwarder::{ForwardError, RequestForwarder};
use super::frame_publisher::FramePublisher;
use super::json::{JSON_HEADERS, Rejection, error_reply, json_reply, parse_body, rejection};
use super::state::DashboardState;
use super::websocket::{CLIENTS_MAX, open_websocket};
use super::{DashboardSource, assets, audit, csv, mission_file, origin_check, session};
use crate::admission::{Admission, AuthenticatedClient, admit};
use crate::fleet_model::{LogEntry, Reachability};
use crate::recording::PlayerCommand;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Extension, Router};
use consort_protocol::access::required_scope;
use consort_protocol::api::RobotSelection;
use consort_protocol::ids::{MissionId, RobotId, TaskId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::mission::FILE_BYTES_MAX;
use consort_protocol::trust::AccessScope;
use consort_protocol::view::{FleetView, NodeView};
use consort_skills::missions::{NamedMissions, OfferedMission};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Maximum number of events per reply.
const EVENTS: usize = 500;

/// Returns the server's routes.
pub(super) fn router(
    publisher: Arc<FramePublisher>,
    served: DashboardSource,
    admission: Admission,
    missions: Arc<NamedMissions>,
    address: SocketAddr,
) -> Router {
    let pages = assets::ALL
        .iter()
        .fold(Router::new(), |router, asset| router.route(asset.path, get(move || async move { asset })));
    let guarded = |scope, route: MethodRouter<DashboardState>| {
        route.layer(axum::middleware::from_fn_with_state((admission.clone(), scope), admit))
    };
    let order = |call: ApiCall| guarded(required_scope(call), post(forward_order).layer(Extension(call)));
    let action = |call: ApiCall| guarded(required_scope(call), post(forward_action).layer(Extension(call)));
    pages
        .route("/ws", guarded(AccessScope::Read, get(open_websocket)))
        .route("/api/fleet", guarded(AccessScope::Read, get(model)))
        .route("/api/events", guarded(AccessScope::Read, get(events)))
        .route("/api/named-missions", guarded(AccessScope::Read, get(named_missions)))
        .route("/api/mission-file", guarded(AccessScope::Read, post(mission_file::read)))
        .route("/api/history.csv", guarded(AccessScope::Read, get(history)))
        .route("/api/missions", guarded(required_scope(ApiCall::Submit), post(submit)))
        .route("/api/missions/cancel", order(ApiCall::CancelMissions))
        .route("/api/priority", order(ApiCall::Priority))
        .route("/api/reassign", order(ApiCall::Reassign))
        .route("/api/missions/{id}/cancel", action(ApiCall::Cancel))
        .route("/api/missions/{id}/resolve", action(ApiCall::Resolve))
        .route("/api/schedules/{id}", guarded(required_scope(ApiCall::Schedule), post(change_schedule)))
        .route("/api/robots/select", guarded(required_scope(ApiCall::Hold), post(select_robots)))
        .route("/api/hold", order(ApiCall::Hold))
        .route("/api/release", order(ApiCall::Release))
        .route("/api/maintenance", order(ApiCall::Maintenance))
        .route("/api/close", order(ApiCall::Close))
        .route("/api/open", order(ApiCall::Open))
        .route("/api/limit", order(ApiCall::Limit))
        .route("/api/alarm", order(ApiCall::Alarm))
        .route("/api/audit", guarded(required_scope(ApiCall::Audit), get(audit_trail)))
        .route("/api/audit.jsonl", guarded(required_scope(ApiCall::Audit), get(export_audit_trail)))
        .route("/api/requests", guarded(AccessScope::Read, get(requests)))
        .route("/api/requests/{id}/answer", guarded(required_scope(ApiCall::Answer), post(answer)))
        .route("/api/replay", guarded(AccessScope::Read, get(replay).post(control_replay)))
        .route("/api/session", get(session::current).post(session::begin).delete(session::end))
        .route("/healthz", get(health))
        .layer(DefaultBodyLimit::max(FILE_BYTES_MAX))
        .layer(axum::middleware::from_fn_with_state(address, origin_check::check_origin))
        .with_state(DashboardState {
            publisher,
            served,
            admission,
            missions,
            client_permits: Arc::new(Semaphore::new(CLIENTS_MAX)),
        })
}

async fn model(State(shared): State<DashboardState>) -> Response {
    let (_, whole) = shared.publisher.full_frame();
    (StatusCode::OK, JSON_HEADERS, whole.to_string()).into_response()
}

/// Filter of events: after a number, of a kind, mission or robot, with a text in them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EventFilter {
    after: Option<u64>,
    kind: Option<String>,
    mission: Option<String>,
    robot: Option<String>,
    text: Option<String>,
    limit: Option<usize>,
}

/// Reply with events of the log.
#[derive(Serialize)]
struct EventsReply {
    events: Vec<NumberedEvent>,
}

/// An event with its number in the log.
#[derive(Serialize)]
struct NumberedEvent {
    number: u64,
    event: LogEntry,
}

async fn events(State(shared): State<DashboardState>, Query(filter): Query<EventFilter>) -> Response {
    let text = filter.text.as_deref().unwrap_or("").to_lowercase();
    let is = |filter: &Option<String>, is: Option<&str>| filter.as_deref().is_none_or(|filter| is == Some(filter));
    let found = shared.publisher.with_model(|model, _| {
        let later = model.log().range(filter.after.map_or(0, |after| after.saturating_add(1))..);
        let fitting = later.filter(|(_, event)| {
            is(&filter.kind, Some(&event.kind))
                && is(&filter.mission, event.mission.as_deref())
                && is(&filter.robot, event.robot.as_deref())
                && event.text.to_lowercase().contains(&text)
        });
        let found = fitting.take(filter.limit.unwrap_or(EVENTS).min(EVENTS));
        found.map(|(number, event)| NumberedEvent { number: *number, event: event.clone() }).collect()
    });
    json_reply(StatusCode::OK, &EventsReply { events: found })
}

/// Reply with the missions that the visitor may submit by name.
#[derive(Serialize)]
struct NamedMissionsReply<'a> {
    missions: Vec<OfferedMission<'a>>,
}

async fn named_missions(
    State(shared): State<DashboardState>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
) -> Response {
    let may_submit = |name: &TaskId| client.as_ref().is_none_or(|client| client.claims.missions.permits(name.as_str()));
    let missions = shared.missions.offered().filter(|offered| may_submit(offered.mission)).collect();
    json_reply(StatusCode::OK, &NamedMissionsReply { missions })
}

async fn history(State(shared): State<DashboardState>) -> Response {
    let table = shared.publisher.with_model(|model, _| csv::history(model));
    let head = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"missions.csv\""),
    ];
    (head, table).into_response()
}

async fn submit(
    State(shared): State<DashboardState>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let request: Value = parse_body(&headers, &body)?;
    let now_ms = shared.publisher.with_model(|_, now_ms| now_ms);
    Ok(reply_of(forwarder.submit(request, client.as_ref(), now_ms).await))
}

/// Reply with the requests to people, the missions, and where else to see them.
#[derive(Serialize)]
struct PeopleReply<'a> {
    requests: Option<Value>,
    missions: Option<Value>,
    dashboards: &'a [String],
}

async fn requests(State(shared): State<DashboardState>) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    Ok(match tokio::join!(forwarder.read(Key::Api(ApiCall::Requests)), forwarder.read(Key::Api(ApiCall::List))) {
        (Ok(mut requests), Ok(mut missions)) => json_reply(
            StatusCode::OK,
            &PeopleReply {
                requests: requests.get_mut("requests").map(Value::take),
                missions: missions.get_mut("missions").map(Value::take),
                dashboards: forwarder.dashboards(),
            },
        ),
        (Err(problem), _) | (_, Err(problem)) => reply_of(Err(problem)),
    })
}

async fn answer(
    State(shared): State<DashboardState>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let fields = fields_about("request", id, &headers, &body)?;
    Ok(reply_of(forwarder.answer(&fields, client.as_ref()).await))
}

async fn change_schedule(
    State(shared): State<DashboardState>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let fields = fields_about("schedule", id, &headers, &body)?;
    Ok(reply_of(forwarder.act(ApiCall::Schedule, fields, client.as_ref()).await))
}

/// Forwards an order that names its subjects: robots, missions, roles, alarms, or places and lanes.
async fn forward_order(
    State(shared): State<DashboardState>,
    Extension(call): Extension<ApiCall>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let fields: Map<String, Value> = parse_body(&headers, &body)?;
    Ok(reply_of(forwarder.act(call, fields, client.as_ref()).await))
}

/// The robots of an order, as in the order.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotQuery {
    robots: RobotSelection,
}

/// Reply with the robots that an order would affect now.
#[derive(Serialize)]
struct SelectedRobots {
    robots: BTreeSet<RobotId>,
}

/// Returns the robots that an order would affect now, without giving it.
async fn select_robots(
    State(shared): State<DashboardState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let RobotQuery { robots } = parse_body(&headers, &body)?;
    let view = match forwarder.read(Key::ViewFleet).await {
        Ok(view) => FleetView::deserialize(view),
        Err(problem) => return Ok(reply_of(Err(problem))),
    };
    let FleetView { nodes, declared, .. } = view.map_err(|problem| {
        rejection(StatusCode::SERVICE_UNAVAILABLE, &format!("the view of the fleet cannot be read: {problem}"))
    })?;
    let record_of = |NodeView { node, record, .. }: NodeView| Some((RobotId::from(node), record.robot?));
    let known: BTreeMap<RobotId, RobotKnowledge> = nodes.into_iter().filter_map(record_of).collect();
    let robots = robots
        .among(&known, &declared.zones)
        .map_err(|problem| rejection(StatusCode::BAD_REQUEST, &problem.to_string()))?;
    Ok(json_reply(StatusCode::OK, &SelectedRobots { robots }))
}

async fn audit_trail(State(shared): State<DashboardState>) -> Result<Response, Rejection> {
    Ok(reply_of(forwarder(&shared)?.read(Key::Api(ApiCall::Audit)).await))
}

async fn export_audit_trail(State(shared): State<DashboardState>) -> Result<Response, Rejection> {
    let head = [
        (header::CONTENT_TYPE, "application/jsonl"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"audit.jsonl\""),
    ];
    Ok(match forwarder(&shared)?.read(Key::Api(ApiCall::Audit)).await {
        Ok(view) => (head, audit::json_lines(&view)).into_response(),
        Err(problem) => reply_of(Err(problem)),
    })
}

/// Parses the fields of a request, and adds the object that the path names.
fn fields_about(object: &str, id: String, headers: &HeaderMap, body: &[u8]) -> Result<Map<String, Value>, Rejection> {
    let mut fields: Map<String, Value> = parse_body(headers, body)?;
    fields.insert(object.to_owned(), id.into());
    Ok(fields)
}

/// Name of the responsible person; by default the dashboard. The coordinator adds the token's name.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponsiblePerson {
    by: Option<String>,
}

/// Forwards a person's action on a mission.
async fn forward_action(
    State(shared): State<DashboardState>,
    Extension(call): Extension<ApiCall>,
    Extension(client): Extension<Option<AuthenticatedClient>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let forwarder = forwarder(&shared)?;
    let mission = MissionId::new(id).map_err(|mistake| rejection(StatusCode::BAD_REQUEST, &mistake.to_string()))?;
    let ResponsiblePerson { by } =
        if body.is_empty() { ResponsiblePerson::default() } else { parse_body(&headers, &body)? };
    let by = by.filter(|by| !by.trim().is_empty());
    Ok(reply_of(forwarder.act_on_mission(call, &mission, by, client.as_ref()).await))
}

async fn replay(State(shared): State<DashboardState>) -> Response {
    match &shared.served {
        DashboardSource::Recording(server) => json_reply(StatusCode::OK, &server.state()),
        DashboardSource::Fleet(_) | DashboardSource::ViewOnly => no_recording().into_response(),
    }
}

async fn control_replay(
    State(shared): State<DashboardState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let DashboardSource::Recording(server) = &shared.served else { return Err(no_recording()) };
    let command: PlayerCommand = parse_body(&headers, &body)?;
    Ok(match server.apply_command(command) {
        Ok(state) => json_reply(StatusCode::OK, &state),
        Err(mistake) => error_reply(StatusCode::BAD_REQUEST, &mistake.to_string()),
    })
}

/// Reply of the health check.
#[derive(Serialize)]
struct HealthReply {
    serving: bool,
    reachability: Reachability,
}

async fn health(State(shared): State<DashboardState>) -> Response {
    let reachability = shared.publisher.with_model(|model, _| model.reachability().clone());
    json_reply(StatusCode::OK, &HealthReply { serving: true, reachability })
}

fn reply_of(outcome: Result<Value, ForwardError>) -> Response {
    match outcome {
        Ok(value) => json_reply(StatusCode::OK, &value),
        Err(ForwardError::Rejected(what)) => error_reply(StatusCode::BAD_REQUEST, &what),
        Err(ForwardError::Unreachable(what)) => error_reply(StatusCode::SERVICE_UNAVAILABLE, &what),
    }
}

fn forwarder(shared: &DashboardState) -> Result<&RequestForwarder, Rejection> {
    match &shared.served {
        DashboardSource::Fleet(forwarder) => Ok(forwarder),
        DashboardSource::Recording(server) => {
            let what = format!("{}: a recorded fleet accepts no requests", server.description());
            Err(rejection(StatusCode::CONFLICT, &what))
        }
        DashboardSource::ViewOnly => {
            let what = "the shown model is not a running fleet; it accepts no requests";
            Err(rejection(StatusCode::SERVICE_UNAVAILABLE, what))
        }
    }
}

fn no_recording() -> Rejection {
    rejection(StatusCode::NOT_FOUND, "the shown model is not a recording")
}
