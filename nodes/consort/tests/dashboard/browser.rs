//! A headless browser and the actions of its user.

use crate::slots::Slot;
use crate::support::{Folder, skip, until};
use fantoccini::actions::{InputSource, KeyAction, KeyActions};
use fantoccini::wd::WebDriverCompatibleCommand;
use fantoccini::{Client, ClientBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};
use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tokio::runtime::Runtime;

/// Limit for the page to show something.
pub(crate) const SOON: Duration = Duration::from_secs(90);

/// Control key in WebDriver.
const CONTROL: char = '\u{e009}';

/// Releases the control key.
const RELEASE: char = '\u{e000}';

/// Chromium, driven by chromedriver.
pub(crate) struct Browser {
    runtime: Runtime,
    client: Client,
    driver: Child,
    _slot: Slot,
}

/// A command of chromedriver beyond the standard.
#[derive(Debug)]
struct Raw {
    path: &'static str,
    body: Value,
}

impl WebDriverCompatibleCommand for Raw {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/{}", session.unwrap_or_default(), self.path))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        (http::Method::POST, Some(self.body.to_string()))
    }
}

impl Browser {
    /// Starts a browser. Returns `None` and skips the test if there is none.
    pub(crate) fn start(folder: &Folder) -> Option<Browser> {
        for program in ["chromedriver", "chromium"] {
            let there = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
            if !there.is_ok_and(|status| status.success()) {
                skip(&format!("no program {program} (apt-get install chromium chromium-driver)"));
                return None;
            }
        }
        let slot = Slot::take();
        let output = folder.path().join("chromedriver.out");
        let out = File::create(&output).expect("the folder can be written to");
        let mut command = Command::new("chromedriver");
        command
            .arg("--port=0")
            .env("TMPDIR", folder.temporary())
            .stdin(Stdio::null())
            .stdout(out)
            .stderr(Stdio::null());
        let driver = command.spawn().expect("chromedriver can be started");
        let port = until("the port of chromedriver", SOON, || {
            let output = fs::read_to_string(&output).ok()?;
            let (_, rest) = output.split_once("successfully on port ")?;
            rest.split(|sign: char| !sign.is_ascii_digit()).next()?.parse::<u16>().ok()
        });
        let options = json!({
            "args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
                "--no-first-run", "--window-size=1440,1000",
                format!("--user-data-dir={}", folder.path().join("profile").display())],
        });
        let wanted = json!({
            "browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": { "browser": "ALL" },
            "unhandledPromptBehavior": "ignore",
        });
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.expect("a runtime");
        let connected = runtime.block_on(async {
            let mut builder = ClientBuilder::new(HttpConnector::new());
            builder.capabilities(wanted.as_object().expect("an object").clone());
            builder.connect(&format!("http://127.0.0.1:{port}")).await
        });
        let client = connected.expect("a session with the browser");
        Some(Browser { runtime, client, driver, _slot: slot })
    }

    pub(crate) fn open(&self, url: &str) {
        self.runtime.block_on(self.client.goto(url)).expect("the page can be opened");
    }

    /// Evaluates a JavaScript expression.
    pub(crate) fn value(&self, expression: &str) -> Value {
        let script = format!("return ({expression});");
        self.runtime
            .block_on(self.client.execute(&script, vec![]))
            .unwrap_or_else(|problem| panic!("{expression}: {problem}"))
    }

    pub(crate) fn text(&self, selector: &str) -> String {
        let value = self.value(&format!("document.querySelector({selector:?})?.innerText ?? ''"));
        value.as_str().unwrap_or_default().to_owned()
    }

    /// Waits until an expression is true on the page.
    #[track_caller]
    pub(crate) fn wait_until(&self, what: &str, expression: &str) {
        self.wait_until_within(SOON, what, expression);
    }

    #[track_caller]
    pub(crate) fn wait_until_within(&self, limit: Duration, what: &str, expression: &str) {
        let seen = std::cell::Cell::new(false);
        // An expression about an element that is not drawn yet is false.
        let script = format!(
            "(() => {{ try {{ return Boolean({expression}); }} catch (problem) {{ if (problem instanceof TypeError) return false; throw problem; }} }})()"
        );
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            until(what, limit, || (self.value(&script) == true).then(|| seen.set(true)));
        }));
        if outcome.is_err() {
            let test = std::thread::current().name().unwrap_or("main").replace("::", "-");
            self.screenshot(&format!("failed-{test}"));
            panic!(
                "not seen within {limit:?}: {what}: {expression}\n--- the page\n{}\n--- its console\n{:#?}",
                self.text("body"),
                self.console()
            );
        }
    }

    /// Types keys into the focused element. Control is held until [`RELEASE`].
    pub(crate) fn press(&self, keys: &str) {
        let mut actions = KeyActions::new("keyboard".to_owned());
        for value in keys.chars() {
            actions = match value {
                CONTROL => actions.then(KeyAction::Down { value }),
                RELEASE => actions.then(KeyAction::Up { value: CONTROL }),
                _ => actions.then(KeyAction::Down { value }).then(KeyAction::Up { value }),
            };
        }
        self.runtime.block_on(self.client.perform_actions(actions)).expect("keys can be pressed");
    }

    pub(crate) fn click(&self, selector: &str) {
        let clicked =
            self.runtime.block_on(async { self.client.find(fantoccini::Locator::Css(selector)).await?.click().await });
        clicked.unwrap_or_else(|problem| panic!("{selector}: {problem}"));
    }

    /// Chooses a file.
    pub(crate) fn upload(&self, selector: &str, path: &Path) {
        let path = path.display().to_string();
        let sent = self
            .runtime
            .block_on(async { self.client.find(fantoccini::Locator::Css(selector)).await?.send_keys(&path).await });
        sent.unwrap_or_else(|problem| panic!("{selector}: {problem}"));
    }

    /// Confirms the dialog of the page.
    pub(crate) fn accept(&self) {
        until("a question", SOON, || self.runtime.block_on(self.client.accept_alert()).ok());
    }

    /// Sends a command of the DevTools protocol.
    pub(crate) fn command(&self, name: &str, parameters: Value) -> Value {
        let raw = Raw { path: "goog/cdp/execute", body: json!({ "cmd": name, "params": parameters }) };
        self.runtime.block_on(self.client.issue_cmd(raw)).unwrap_or_else(|problem| panic!("{name}: {problem}"))
    }

    /// Permits notifications to the pages of an address, and lists those that the open page shows from now on in
    /// `window.shown`, each by title, text and tag. `window.tones` is the number of tones that the page plays.
    pub(crate) fn watch_notifications(&self) {
        let origin = self.value("location.origin");
        self.command("Browser.grantPermissions", json!({ "permissions": ["notifications"], "origin": origin }));
        self.value(
            "((Shown) => { window.shown = []; window.Notification = class extends Shown { constructor(title, options) \
             { super(title, options); window.shown.push([title, options.body, options.tag]); } }; return true; })(Notification)",
        );
        self.value(
            "((create) => { window.tones = 0; AudioContext.prototype.createOscillator = function () { window.tones += 1; \
             return create.call(this); }; return true; })(AudioContext.prototype.createOscillator)",
        );
    }

    /// Sets the size of the screen; a narrow screen is a phone.
    pub(crate) fn screen(&self, width: u32, height: u32) {
        let phone = width < 700;
        let parameters = json!({ "width": width, "height": height, "deviceScaleFactor": if phone { 2 } else { 1 }, "mobile": phone });
        self.command("Emulation.setDeviceMetricsOverride", parameters);
    }

    /// Sets the preferred colour scheme: `light` or `dark`.
    pub(crate) fn prefers(&self, scheme: &str) {
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.command("Emulation.setEmulatedMedia", json!({ "features": features }));
    }

    /// Stores a screenshot.
    pub(crate) fn screenshot(&self, name: &str) {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("dashboard");
        let model = self.runtime.block_on(self.client.screenshot()).expect("a picture can be taken");
        fs::create_dir_all(&folder).expect("the folder can be made");
        fs::write(folder.join(format!("{name}.png")), &model).expect("the folder can be written to");
    }

    /// Stores a screenshot, also for the documentation if requested.
    pub(crate) fn documentation_screenshot(&self, name: &str) {
        self.screenshot(name);
        if std::env::var_os("CONSORT_PICTURES").is_some() {
            let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
            fs::create_dir_all(&docs).expect("the folder can be made");
            let taken = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("dashboard/{name}.png"));
            fs::copy(taken, docs.join(format!("dashboard-{name}.png"))).expect("a file can be copied");
        }
    }

    /// Returns the new warnings and errors of the console.
    pub(crate) fn console(&self) -> Vec<String> {
        let raw = Raw { path: "se/log", body: json!({ "type": "browser" }) };
        let entries = self.runtime.block_on(self.client.issue_cmd(raw)).expect("the browser keeps a log");
        let bad = |entry: &&Value| entry["level"] == "SEVERE" || entry["level"] == "WARNING";
        let text = |entry: &Value| entry["message"].as_str().unwrap_or_default().to_owned();
        entries.as_array().into_iter().flatten().filter(bad).map(text).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // The end of the session ends the browser; leftover processes are found by their folder.
        let _ = self.runtime.block_on(self.client.clone().close());
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
