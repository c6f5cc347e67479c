//! The page's files, compiled into the program.

use axum::http::header;
use axum::response::{IntoResponse, Response};

/// A file.
pub(super) struct Asset {
    /// URL path.
    pub(super) path: &'static str,
    kind: &'static str,
    text: &'static str,
}

impl IntoResponse for &'static Asset {
    fn into_response(self) -> Response {
        ([(header::CONTENT_TYPE, self.kind)], self.text).into_response()
    }
}

macro_rules! assets {
    ($($path:literal $kind:literal $file:literal),* $(,)?) => {
        /// All files.
        pub(super) static ALL: &[Asset] = &[$(Asset { path: $path, kind: $kind, text: include_str!($file) }),*];
    };
}

assets! {
    "/" "text/html; charset=utf-8" "assets/index.html",
    "/console.css" "text/css; charset=utf-8" "assets/console.css",
    "/icon.svg" "image/svg+xml" "assets/icon.svg",
    "/app.js" "text/javascript; charset=utf-8" "assets/app.js",
    "/connection.js" "text/javascript; charset=utf-8" "assets/connection.js",
    "/dom.js" "text/javascript; charset=utf-8" "assets/dom.js",
    "/theme.js" "text/javascript; charset=utf-8" "assets/theme.js",
    "/status.js" "text/javascript; charset=utf-8" "assets/status.js",
    "/tabs.js" "text/javascript; charset=utf-8" "assets/tabs.js",
    "/map.js" "text/javascript; charset=utf-8" "assets/map.js",
    "/robot.js" "text/javascript; charset=utf-8" "assets/robot.js",
    "/robots.js" "text/javascript; charset=utf-8" "assets/robots.js",
    "/missions.js" "text/javascript; charset=utf-8" "assets/missions.js",
    "/mission_orders.js" "text/javascript; charset=utf-8" "assets/mission_orders.js",
    "/gantt.js" "text/javascript; charset=utf-8" "assets/gantt.js",
    "/pointer.js" "text/javascript; charset=utf-8" "assets/pointer.js",
    "/robot_signs.js" "text/javascript; charset=utf-8" "assets/robot_signs.js",
    "/crowd.js" "text/javascript; charset=utf-8" "assets/crowd.js",
    "/sprites.js" "text/javascript; charset=utf-8" "assets/sprites.js",
    "/schedule.js" "text/javascript; charset=utf-8" "assets/schedule.js",
    "/alarms.js" "text/javascript; charset=utf-8" "assets/alarms.js",
    "/auctions.js" "text/javascript; charset=utf-8" "assets/auctions.js",
    "/fleet.js" "text/javascript; charset=utf-8" "assets/fleet.js",
    "/calendar.js" "text/javascript; charset=utf-8" "assets/calendar.js",
    "/log.js" "text/javascript; charset=utf-8" "assets/log.js",
    "/chargers.js" "text/javascript; charset=utf-8" "assets/chargers.js",
    "/closures.js" "text/javascript; charset=utf-8" "assets/closures.js",
    "/places.js" "text/javascript; charset=utf-8" "assets/places.js",
    "/order_form.js" "text/javascript; charset=utf-8" "assets/order_form.js",
    "/orders.js" "text/javascript; charset=utf-8" "assets/orders.js",
    "/audit.js" "text/javascript; charset=utf-8" "assets/audit.js",
    "/action.js" "text/javascript; charset=utf-8" "assets/action.js",
    "/request.js" "text/javascript; charset=utf-8" "assets/request.js",
    "/mission_form.js" "text/javascript; charset=utf-8" "assets/mission_form.js",
    "/submit.js" "text/javascript; charset=utf-8" "assets/submit.js",
    "/session.js" "text/javascript; charset=utf-8" "assets/session.js",
    "/replay.js" "text/javascript; charset=utf-8" "assets/replay.js",
    "/me" "text/html; charset=utf-8" "assets/me.html",
    "/me.js" "text/javascript; charset=utf-8" "assets/me.js",
    "/me.css" "text/css; charset=utf-8" "assets/me.css",
    "/replay.css" "text/css; charset=utf-8" "assets/replay.css",
}
