//! The page of all cells: its server, for the one computer it runs on.
//!
//! In: a [`FleetView`] whenever there is another one. Out: the page, with the components of a cell's own,
//! and the view as JSON. It gives no order, listens on loopback alone, and shows nothing without the key of
//! its link: on a computer with several users the fleet is shown to who has the credentials.

use crate::config::page::PageConfig;
use crate::fleet::view::FleetView;
use crate::page::ServeError;
use crate::page::assets::asset;
use crate::page::guard::{harden, refusal};
use crate::page::limits::host_is_ours;
use crate::page::server::Listening;
use axum::Router;
use axum::body::Bytes;
use axum::extract::{Path, Request, State};
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, HOST};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use subtle::ConstantTimeEq;

/// What the page of all cells has beside the files of a cell's page.
const FILES: [(&str, &str, &str); 3] = [
    ("fleet.html", "text/html; charset=utf-8", include_str!("assets/fleet.html")),
    ("fleet.css", "text/css; charset=utf-8", include_str!("assets/fleet.css")),
    ("fleet.js", "text/javascript; charset=utf-8", include_str!("assets/fleet.js")),
];

struct Shared {
    config: PageConfig,
    key: String,
    latest: Mutex<Bytes>,
}

/// A page that is served.
#[derive(Clone)]
pub struct FleetPage(Arc<Shared>);

impl FleetPage {
    /// Opens the address and serves from now on; the link comes with it.
    ///
    /// # Errors
    /// The address is not of loopback or cannot be used; no random numbers, no thread.
    pub fn start(listen: SocketAddr) -> Result<FleetPage, String> {
        if !listen.ip().is_loopback() {
            return Err(format!(
                "{listen}: the page of all cells is for this computer alone: 127.0.0.1:PORT"
            ));
        }
        let mut config =
            PageConfig { listen, hosts: Vec::new(), control_from: Vec::new(), tls: None, texts: Vec::new() };
        let listening = Listening::open(&config).map_err(|error| match error {
            ServeError::Bind { address, source } => format!("{address} cannot be used: {source}"),
            error @ (ServeError::Tls { .. } | ServeError::Texts { .. } | ServeError::Thread(_)) => {
                error.to_string()
            }
        })?;
        config.listen = listening.address().unwrap_or(listen);
        let shared = Arc::new(Shared { config, key: random_key()?, latest: Mutex::new(Bytes::new()) });
        let page = FleetPage(shared.clone());
        listening.serve(move || router(shared)).map_err(|error| error.to_string())?;
        Ok(page)
    }

    /// What opens it.
    pub fn link(&self) -> String {
        format!("{}/#key={}", self.0.config.address(), self.0.key)
    }

    /// Shows this from now on.
    pub fn show(&self, view: &FleetView) {
        // Numbers and texts: nothing that JSON does not have.
        let bytes = serde_json::to_vec(view).unwrap_or_default();
        *self.0.latest.lock().unwrap_or_else(PoisonError::into_inner) = bytes.into();
    }
}

fn random_key() -> Result<String, String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| format!("no random numbers: {error}"))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(|| async { own("fleet.html").unwrap_or_else(not_found) }))
        .route("/api/v1/fleet", get(view))
        .route("/{file}", get(file))
        .layer(from_fn_with_state(shared.clone(), every_request))
        .with_state(shared)
}

/// By its own name alone: a foreign name that leads here is a page of a stranger.
async fn every_request(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let host = request.headers().get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let mut response = match host_is_ours(&shared.config, host) {
        true => next.run(request).await,
        false => refusal(StatusCode::MISDIRECTED_REQUEST, "this is no name of this page"),
    };
    harden(response.headers_mut());
    response
}

fn not_found() -> Response {
    refusal(StatusCode::NOT_FOUND, "not found")
}

fn own(name: &str) -> Option<Response> {
    let (_, kind, text) = FILES.iter().find(|(known, ..)| *known == name)?;
    Some(([(CONTENT_TYPE, *kind)], *text).into_response())
}

async fn file(Path(name): Path<String>, headers: HeaderMap) -> Response {
    own(&name).unwrap_or_else(|| asset(&name, &headers))
}

async fn view(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Response {
    let given = headers.get(AUTHORIZATION).and_then(|value| value.to_str().ok());
    let given = given.and_then(|value| value.strip_prefix("Bearer ")).unwrap_or_default();
    if !bool::from(given.as_bytes().ct_eq(shared.key.as_bytes())) {
        return refusal(StatusCode::UNAUTHORIZED, "open the link that `celld fleet page` prints");
    }
    let latest = shared.latest.lock().unwrap_or_else(PoisonError::into_inner).clone();
    if latest.is_empty() {
        return refusal(StatusCode::SERVICE_UNAVAILABLE, "nothing is known of the fleet yet");
    }
    ([(CONTENT_TYPE, "application/json")], latest).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::view::Board;
    use crate::page::assets::known_texts;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    fn request(page: &FleetPage, path: &str, host: &str, key: &str) -> String {
        let mut stream = TcpStream::connect(page.0.config.listen).unwrap();
        let port = page.0.config.listen.port();
        let host = host.replace("PORT", &port.to_string());
        let request = format!(
            "GET {path} HTTP/1.1\r\nhost: {host}\r\nauthorization: Bearer {key}\r\nconnection: close\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    #[test]
    fn the_fleet_is_shown_by_its_own_name_with_the_key_of_the_link_alone() {
        let page = FleetPage::start(([127, 0, 0, 1], 0).into()).unwrap();
        let link = page.link();
        let key = link.rsplit('=').next().unwrap();
        let host = "127.0.0.1:PORT";
        assert!(request(&page, "/api/v1/fleet", host, key).starts_with("HTTP/1.1 503"));
        page.show(&Board::default().view("plant", 5.0, true));
        let answer = request(&page, "/api/v1/fleet", host, key);
        assert!(answer.starts_with("HTTP/1.1 200") && answer.contains(r#""fleet":"plant""#), "{answer}");
        for wrong in ["", "0", &key[1..]] {
            let answer = request(&page, "/api/v1/fleet", host, wrong);
            assert!(answer.starts_with("HTTP/1.1 401") && !answer.contains("plant"), "{wrong}: {answer}");
        }
        assert!(request(&page, "/api/v1/fleet", "evil.example:PORT", key).starts_with("HTTP/1.1 421"));
        for (path, wanted) in [("/", "celld fleet"), ("/fleet.js", "drawCell"), ("/page.css", "--ground")] {
            let answer = request(&page, path, host, "");
            assert!(
                answer.contains(wanted) && answer.contains("content-security-policy"),
                "{path}: {answer}"
            );
        }
        assert!(request(&page, "/nothing", host, "").starts_with("HTTP/1.1 404"));
    }

    #[test]
    fn an_address_of_the_network_is_refused() {
        let fault = FleetPage::start(([0, 0, 0, 0], 0).into()).err().unwrap();
        assert!(fault.contains("this computer alone"), "{fault}");
    }

    #[test]
    fn its_texts_are_in_the_table_and_its_files_are_there() {
        let script = FILES.iter().find(|(name, ..)| *name == "fleet.js").unwrap().2;
        let known = known_texts();
        let mut count = 0;
        for (at, _) in script.match_indices("t(\"") {
            let (before, rest) = script.split_at(at);
            if before.ends_with(|c: char| c.is_ascii_alphanumeric() || c == '.' || c == '_') {
                continue;
            }
            let text = rest[3..].split('"').next().unwrap();
            assert!(known.contains(text), "{text:?} is not in text-de.json");
            count += 1;
        }
        assert!(count > 20, "{count}");
        for line in script.lines().filter(|line| line.starts_with("import ")) {
            let name = line.rsplit('"').nth(1).unwrap().trim_start_matches("./");
            assert_eq!(asset(name, &HeaderMap::new()).status(), StatusCode::OK, "{name}");
        }
    }
}
