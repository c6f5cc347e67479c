//! What can be asked of the dashboard's server.

use super::forwarder::ForwardError;
use super::frame_publisher::FramePublisher;
use super::json::{JSON_HEADERS, error_reply, json_reply, parse_body};
use super::websocket::{CLIENTS_MAX, open_websocket};
use super::{DashboardSource, assets, csv, origin_check, session};
use crate::admission::{Admission, AuthenticatedClient, admit};
use crate::recording::PlayerCommand;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Extension, Router};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::{FILE_BYTES_MAX, shipped};
use consort_protocol::trust::AccessScope;
use consort_protocol::trust::access::required_scope;
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Events given at once.
const EVENTS: usize = 500;

/// What stands behind the routes.
#[derive(Clone)]
pub(super) struct DashboardState {
    pub(super) publisher: Arc<FramePublisher>,
    served: DashboardSource,
    pub(super) admission: Admission,
    pub(super) client_permits: Arc<Semaphore>,
}

/// The server's routes.
pub(super) fn router(
    board: Arc<FramePublisher>,
    served: DashboardSource,
    admission: Admission,
    address: SocketAddr,
) -> Router {
    let pages = assets::ALL
        .iter()
        .fold(Router::new(), |router, asset| router.route(asset.path, get(move || async move { asset })));
    let takes = |scope, route: MethodRouter<DashboardState>| {
        route.layer(axum::middleware::from_fn_with_state((admission.clone(), scope), admit))
    };
    pages
        .route("/ws", takes(AccessScope::Read, get(open_websocket)))
        .route("/api/picture", takes(AccessScope::Read, get(picture)))
        .route("/api/events", takes(AccessScope::Read, get(events)))
        .route("/api/shipped", takes(AccessScope::Read, get(shipped_missions)))
        .route("/api/history.csv", takes(AccessScope::Read, get(history)))
        .route("/api/missions", takes(required_scope(ApiCall::Submit), post(submit)))
        .route("/api/missions/{id}/cancel", takes(required_scope(ApiCall::Cancel), post(cancel)))
        .route("/api/missions/{id}/rescued", takes(required_scope(ApiCall::Resolve), post(rescued)))
        .route("/api/replay", takes(AccessScope::Read, get(replay).post(move_replay)))
        .route("/api/session", get(session::current).post(session::begin).delete(session::end))
        .route("/healthz", get(health))
        .layer(DefaultBodyLimit::max(FILE_BYTES_MAX))
        .layer(axum::middleware::from_fn_with_state(address, origin_check::check_origin))
        .with_state(DashboardState {
            publisher: board,
            served,
            admission,
            client_permits: Arc::new(Semaphore::new(CLIENTS_MAX)),
        })
}

async fn picture(State(shared): State<DashboardState>) -> Response {
    let (_, whole) = shared.publisher.full_frame();
    (StatusCode::OK, JSON_HEADERS, whole.to_string()).into_response()
}

/// Which events are wanted: those after a number, of a kind, mission or robot, with a text in them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    after: Option<u64>,
    kind: Option<String>,
    mission: Option<String>,
    robot: Option<String>,
    text: Option<String>,
    limit: Option<usize>,
}

async fn events(State(shared): State<DashboardState>, Query(wanted): Query<Wanted>) -> Response {
    let text = wanted.text.as_deref().unwrap_or("").to_lowercase();
    let is = |wanted: &Option<String>, is: Option<&str>| wanted.as_deref().is_none_or(|wanted| is == Some(wanted));
    let found = shared.publisher.with_model(|picture, _| {
        let later = picture.log().range(wanted.after.map_or(0, |after| after.saturating_add(1))..);
        let fitting = later.filter(|(_, event)| {
            is(&wanted.kind, Some(&event.kind))
                && is(&wanted.mission, event.mission.as_deref())
                && is(&wanted.robot, event.robot.as_deref())
                && event.text.to_lowercase().contains(&text)
        });
        let found = fitting.take(wanted.limit.unwrap_or(EVENTS).min(EVENTS));
        found.map(|(number, event)| json!({ "number": number, "event": event })).collect::<Vec<_>>()
    });
    json_reply(StatusCode::OK, &json!({ "events": found }))
}

async fn shipped_missions() -> Response {
    let missions = shipped().values().map(|template| {
        json!({ "mission": template.name(), "title": template.title(), "parameters": template.parameters() })
    });
    json_reply(StatusCode::OK, &json!({ "missions": missions.collect::<Vec<_>>() }))
}

async fn history(State(shared): State<DashboardState>) -> Response {
    let table = shared.publisher.with_model(|picture, _| csv::history(picture));
    let head = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"missions.csv\""),
    ];
    (head, table).into_response()
}

async fn submit(State(shared): State<DashboardState>, headers: HeaderMap, body: Bytes) -> Response {
    let DashboardSource::Fleet(desk) = &shared.served else { return no_desk(&shared.served) };
    let request: Value = match parse_body(&headers, &body) {
        Ok(request) => request,
        Err(refusal) => return refusal.into_response(),
    };
    let now_ms = shared.publisher.with_model(|_, now_ms| now_ms);
    settled(desk.submit(request, now_ms).await)
}

async fn cancel(
    State(shared): State<DashboardState>,
    Extension(guest): Extension<Option<AuthenticatedClient>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    on_word(&shared, guest.as_ref(), ApiCall::Cancel, id, &headers, &body).await
}

async fn rescued(
    State(shared): State<DashboardState>,
    Extension(guest): Extension<Option<AuthenticatedClient>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    on_word(&shared, guest.as_ref(), ApiCall::Resolve, id, &headers, &body).await
}

/// By whose word something is done; without one it is the dashboard's. Whose token it was is said beside.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Word {
    by: Option<String>,
}

/// Has something done to a mission that somebody says is to be done.
async fn on_word(
    shared: &DashboardState,
    guest: Option<&AuthenticatedClient>,
    call: ApiCall,
    id: String,
    headers: &HeaderMap,
    body: &[u8],
) -> Response {
    let DashboardSource::Fleet(desk) = &shared.served else { return no_desk(&shared.served) };
    let mission = match MissionId::new(id) {
        Ok(mission) => mission,
        Err(mistake) => return error_reply(StatusCode::BAD_REQUEST, &mistake.to_string()),
    };
    let word = if body.is_empty() { Ok(Word::default()) } else { parse_body(headers, body) };
    match word {
        Ok(Word { by }) => {
            let by = by.filter(|by| !by.trim().is_empty());
            let by = match (by, guest.map(|guest| &guest.claims.name)) {
                (Some(by), Some(name)) if by != name.as_str() => Some(format!("{by}, says {name}")),
                (by, name) => by.or_else(|| name.map(ToString::to_string)),
            };
            settled(desk.act_on_mission(call, &mission, by).await)
        }
        Err(refusal) => refusal.into_response(),
    }
}

async fn replay(State(shared): State<DashboardState>) -> Response {
    match &shared.served {
        DashboardSource::Recording(projector) => json_reply(StatusCode::OK, &projector.state()),
        DashboardSource::Fleet(_) | DashboardSource::ViewOnly => no_recording(),
    }
}

async fn move_replay(State(shared): State<DashboardState>, headers: HeaderMap, body: Bytes) -> Response {
    let DashboardSource::Recording(projector) = &shared.served else { return no_recording() };
    let command: PlayerCommand = match parse_body(&headers, &body) {
        Ok(command) => command,
        Err(refusal) => return refusal.into_response(),
    };
    match projector.apply_command(command) {
        Ok(state) => json_reply(StatusCode::OK, &state),
        Err(mistake) => error_reply(StatusCode::BAD_REQUEST, &mistake),
    }
}

async fn health(State(shared): State<DashboardState>) -> Response {
    let reach = shared.publisher.with_model(|picture, _| picture.reach().clone());
    json_reply(StatusCode::OK, &json!({ "serving": true, "reach": reach }))
}

fn settled(answered: Result<Value, ForwardError>) -> Response {
    match answered {
        Ok(value) => json_reply(StatusCode::OK, &value),
        Err(ForwardError::Rejected(what)) => error_reply(StatusCode::BAD_REQUEST, &what),
        Err(ForwardError::Unreachable(what)) => error_reply(StatusCode::SERVICE_UNAVAILABLE, &what),
    }
}

fn no_desk(served: &DashboardSource) -> Response {
    match served {
        DashboardSource::Recording(projector) => {
            let what = format!("{}: a fleet that was can be asked for nothing", projector.description());
            error_reply(StatusCode::CONFLICT, &what)
        }
        DashboardSource::Fleet(_) | DashboardSource::ViewOnly => {
            let what = "what is shown here is not a fleet that could be asked for anything";
            error_reply(StatusCode::SERVICE_UNAVAILABLE, what)
        }
    }
}

fn no_recording() -> Response {
    error_reply(StatusCode::NOT_FOUND, "what is shown here is no recording")
}
