//! What can be asked of the dashboard's server.

use super::board::Board;
use super::desk::Problem;
use super::follow::{FOLLOWERS, follow};
use super::json::{JSON, answer, problem, read};
use super::{Served, assets, csv, guard, session};
use crate::admission::{Admission, Guest, admit};
use crate::recording::Command;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Extension, Router};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::{FILE_BYTES_MAX, shipped};
use consort_protocol::trust::Scope;
use consort_protocol::trust::access::needed;
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Events given at once.
const EVENTS: usize = 500;

/// What stands behind the routes.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) board: Arc<Board>,
    served: Served,
    pub(super) admission: Admission,
    pub(super) followers: Arc<Semaphore>,
}

/// The server's routes.
pub(super) fn router(board: Arc<Board>, served: Served, admission: Admission, address: SocketAddr) -> Router {
    let pages = assets::ALL
        .iter()
        .fold(Router::new(), |router, asset| router.route(asset.path, get(move || async move { asset })));
    let takes = |scope, route: MethodRouter<Shared>| {
        route.layer(axum::middleware::from_fn_with_state((admission.clone(), scope), admit))
    };
    pages
        .route("/ws", takes(Scope::Read, get(follow)))
        .route("/api/picture", takes(Scope::Read, get(picture)))
        .route("/api/events", takes(Scope::Read, get(events)))
        .route("/api/shipped", takes(Scope::Read, get(shipped_missions)))
        .route("/api/history.csv", takes(Scope::Read, get(history)))
        .route("/api/missions", takes(needed(ApiCall::Submit), post(submit)))
        .route("/api/missions/{id}/cancel", takes(needed(ApiCall::Cancel), post(cancel)))
        .route("/api/missions/{id}/rescued", takes(needed(ApiCall::Rescued), post(rescued)))
        .route("/api/replay", takes(Scope::Read, get(replay).post(move_replay)))
        .route("/api/session", get(session::whose).post(session::begin).delete(session::end))
        .route("/healthz", get(health))
        .layer(DefaultBodyLimit::max(FILE_BYTES_MAX))
        .layer(axum::middleware::from_fn_with_state(address, guard::guard))
        .with_state(Shared { board, served, admission, followers: Arc::new(Semaphore::new(FOLLOWERS)) })
}

async fn picture(State(shared): State<Shared>) -> Response {
    let (_, whole) = shared.board.whole();
    (StatusCode::OK, JSON, whole.to_string()).into_response()
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

async fn events(State(shared): State<Shared>, Query(wanted): Query<Wanted>) -> Response {
    let text = wanted.text.as_deref().unwrap_or("").to_lowercase();
    let is = |wanted: &Option<String>, is: Option<&str>| wanted.as_deref().is_none_or(|wanted| is == Some(wanted));
    let found = shared.board.with(|picture, _| {
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
    answer(StatusCode::OK, &json!({ "events": found }))
}

async fn shipped_missions() -> Response {
    let missions = shipped().values().map(|template| {
        json!({ "mission": template.name(), "title": template.title(), "parameters": template.parameters() })
    });
    answer(StatusCode::OK, &json!({ "missions": missions.collect::<Vec<_>>() }))
}

async fn history(State(shared): State<Shared>) -> Response {
    let table = shared.board.with(|picture, _| csv::history(picture));
    let head = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (header::CONTENT_DISPOSITION, "attachment; filename=\"missions.csv\""),
    ];
    (head, table).into_response()
}

async fn submit(State(shared): State<Shared>, headers: HeaderMap, body: Bytes) -> Response {
    let Served::Fleet(desk) = &shared.served else { return no_desk(&shared.served) };
    let request: Value = match read(&headers, &body) {
        Ok(request) => request,
        Err(refusal) => return refusal.into_response(),
    };
    let now_ms = shared.board.with(|_, now_ms| now_ms);
    settled(desk.submit(request, now_ms).await)
}

async fn cancel(
    State(shared): State<Shared>,
    Extension(guest): Extension<Option<Guest>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    on_word(&shared, guest.as_ref(), ApiCall::Cancel, id, &headers, &body).await
}

async fn rescued(
    State(shared): State<Shared>,
    Extension(guest): Extension<Option<Guest>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    on_word(&shared, guest.as_ref(), ApiCall::Rescued, id, &headers, &body).await
}

/// By whose word something is done; without one it is the dashboard's. Whose token it was is said beside.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Word {
    by: Option<String>,
}

/// Has something done to a mission that somebody says is to be done.
async fn on_word(
    shared: &Shared,
    guest: Option<&Guest>,
    call: ApiCall,
    id: String,
    headers: &HeaderMap,
    body: &[u8],
) -> Response {
    let Served::Fleet(desk) = &shared.served else { return no_desk(&shared.served) };
    let mission = match MissionId::new(id) {
        Ok(mission) => mission,
        Err(mistake) => return problem(StatusCode::BAD_REQUEST, &mistake.to_string()),
    };
    let word = if body.is_empty() { Ok(Word::default()) } else { read(headers, body) };
    match word {
        Ok(Word { by }) => {
            let by = by.filter(|by| !by.trim().is_empty());
            let by = match (by, guest.map(|guest| &guest.visitor.name)) {
                (Some(by), Some(name)) if by != name.as_str() => Some(format!("{by}, says {name}")),
                (by, name) => by.or_else(|| name.map(ToString::to_string)),
            };
            settled(desk.on_word(call, &mission, by).await)
        }
        Err(refusal) => refusal.into_response(),
    }
}

async fn replay(State(shared): State<Shared>) -> Response {
    match &shared.served {
        Served::Recording(projector) => answer(StatusCode::OK, &projector.state()),
        Served::Fleet(_) | Served::Board => no_recording(),
    }
}

async fn move_replay(State(shared): State<Shared>, headers: HeaderMap, body: Bytes) -> Response {
    let Served::Recording(projector) = &shared.served else { return no_recording() };
    let command: Command = match read(&headers, &body) {
        Ok(command) => command,
        Err(refusal) => return refusal.into_response(),
    };
    match projector.obey(command) {
        Ok(state) => answer(StatusCode::OK, &state),
        Err(mistake) => problem(StatusCode::BAD_REQUEST, &mistake),
    }
}

async fn health(State(shared): State<Shared>) -> Response {
    let reach = shared.board.with(|picture, _| picture.reach().clone());
    answer(StatusCode::OK, &json!({ "serving": true, "reach": reach }))
}

fn settled(answered: Result<Value, Problem>) -> Response {
    match answered {
        Ok(value) => answer(StatusCode::OK, &value),
        Err(Problem::Refused(what)) => problem(StatusCode::BAD_REQUEST, &what),
        Err(Problem::Unreached(what)) => problem(StatusCode::SERVICE_UNAVAILABLE, &what),
    }
}

fn no_desk(served: &Served) -> Response {
    match served {
        Served::Recording(projector) => {
            let what = format!("{}: a fleet that was can be asked for nothing", projector.about());
            problem(StatusCode::CONFLICT, &what)
        }
        Served::Fleet(_) | Served::Board => {
            let what = "what is shown here is not a fleet that could be asked for anything";
            problem(StatusCode::SERVICE_UNAVAILABLE, what)
        }
    }
}

fn no_recording() -> Response {
    problem(StatusCode::NOT_FOUND, "what is shown here is no recording")
}
