//! Connections to the RTDE server, protocol versions 1 and 2.
//!
//! In: packages. Out: replies and, after a start, data packages from the outlets. A connection has one
//! output recipe (a second replaces it) and up to 255 input recipes, numbered from 1 in the order they are
//! requested; input packages are taken before and without a start, longer ones are cut to their recipe, as
//! clients in use rely on. What is wrong with a package is said in a text message; only a broken length ends
//! the connection.

use crate::controller::Controller;
use crate::controller::outputs;
use crate::controller::registers::{ClientId, Input};
use crate::motion::FRAMES_PER_SECOND;
use crate::robot_server::line::{Inlet, Way};
use crate::robot_server::publisher::{Feed, Plan};
use crate::robot_server::shared::RobotShared;
use std::sync::Arc;
use ur_wire::bytes::WireError;
use ur_wire::rtde::{ControllerVersion, Level, MAX_NAMES, Reply, Request, Splitter, TextMessage, Version};
use ur_wire::rtde_values::{Leftover, Offer, Recipe};
use ur_wire::rtde_variables;

/// Frames between packages of a version 1 client, which cannot choose (125 Hz).
const VERSION_1_INTERVAL: u64 = 4;

/// Input recipes of a connection.
const MAX_RECIPES: usize = 255;

/// First software version that bounds the list of names in a request.
const BOUNDED_SINCE: u32 = 10;

/// An input recipe.
struct InputRecipe {
    recipe: Recipe,
    fields: Vec<Input>,
}

/// One connection, without its socket.
pub struct Session {
    id: ClientId,
    version: Version,
    inputs: Vec<InputRecipe>,
    splitter: Splitter,
    /// A start was promised, and its reply is not on its way yet.
    starts: bool,
}

impl Session {
    /// Adds the connection to the outlets.
    pub fn open(shared: &RobotShared, way: Option<Arc<dyn Way>>) -> (Session, Inlet) {
        let (id, inlet) = shared.publisher().open(Feed::Rtde, false, way);
        let (version, splitter) = (Version::V1, Splitter::default());
        (Session { id, version, inputs: Vec::new(), splitter, starts: false }, inlet)
    }

    /// The connection's number.
    pub fn id(&self) -> ClientId {
        self.id
    }

    /// Carries out what arrived; the answers, one package each.
    ///
    /// # Errors
    /// An impossible length; the connection ends.
    pub fn receive(&mut self, shared: &RobotShared, bytes: &[u8]) -> Result<Vec<Vec<u8>>, WireError> {
        self.splitter.push(bytes);
        let mut answers = Vec::new();
        while let Some(frame) = self.splitter.next_frame()? {
            let reply = match Request::decode(self.version, &frame) {
                Ok(request) => self.handle(shared, request),
                Err(error) => Some((self.text(&error.to_string()), self.version)),
            };
            answers.extend(reply.map(|(reply, version)| reply.encode(version)));
        }
        Ok(answers)
    }

    /// The answers of [`Session::receive`] are on their way: data follow, never ahead of the reply that
    /// announced them.
    pub fn answered(&mut self, shared: &RobotShared) {
        if std::mem::take(&mut self.starts) {
            shared.publisher().start(self.id);
        }
    }

    /// Gives back what the connection has claimed.
    pub fn close(&self, shared: &RobotShared) {
        shared.controller().core.registers.release(self.id);
        shared.publisher().close(self.id);
    }

    /// The reply and the version to write it in; `None` if there is none.
    fn handle(&mut self, shared: &RobotShared, request: Request) -> Option<(Reply, Version)> {
        let before = self.version;
        let reply = match request {
            Request::ProtocolVersion(wanted) => {
                self.version = match wanted {
                    1 => Version::V1,
                    2 => Version::V2,
                    _ => return Some((Reply::ProtocolVersion(false), before)),
                };
                Reply::ProtocolVersion(true)
            }
            Request::ControllerVersion => {
                let [major, minor, bugfix, build] = shared.controller().core.version();
                Reply::ControllerVersion(ControllerVersion { major, minor, bugfix, build })
            }
            Request::Text(text) => {
                tracing::info!(text.message, text.source, "message of an RTDE client");
                return None;
            }
            Request::SetupOutputs { frequency_hz, names } => {
                self.set_up_outputs(shared, frequency_hz, &names)
            }
            Request::SetupInputs { names } => self.set_up_inputs(&mut shared.controller(), &names),
            Request::Start => {
                self.starts = shared.publisher().has_recipe(self.id);
                Reply::Start(self.starts)
            }
            Request::Pause => {
                self.starts = false;
                shared.publisher().pause(self.id);
                Reply::Pause(true)
            }
            Request::Data { recipe, payload } => return self.write(shared, recipe, &payload),
        };
        Some((reply, before))
    }

    fn set_up_outputs(&self, shared: &RobotShared, frequency_hz: Option<f64>, names: &[String]) -> Reply {
        if too_long(&shared.controller(), names) {
            return Reply::SetupOutputs { recipe: 0, offers: vec![Offer::NotFound; names.len()] };
        }
        let offers: Vec<Offer> = names
            .iter()
            .map(|name| rtde_variables::output_type(name).map_or(Offer::NotFound, Offer::Type))
            .collect();
        let fields: Option<Vec<_>> = names.iter().map(|name| outputs::find(name)).collect();
        let interval = match frequency_hz {
            None => Some(VERSION_1_INTERVAL),
            Some(frequency) => interval(frequency),
        };
        let recipe = recipe(1, names, &offers);
        let (Some(recipe), Some(fields), Some(interval)) = (recipe, fields, interval) else {
            return Reply::SetupOutputs { recipe: 0, offers };
        };
        let plan = Plan { recipe, fields, version: self.version };
        shared.publisher().subscribe(self.id, plan, interval);
        Reply::SetupOutputs { recipe: 1, offers }
    }

    fn set_up_inputs(&mut self, controller: &mut Controller, names: &[String]) -> Reply {
        if self.inputs.len() >= MAX_RECIPES || too_long(controller, names) {
            return Reply::SetupInputs { recipe: 0, offers: vec![Offer::NotFound; names.len()] };
        }
        let id = self.inputs.len() as u8 + 1;
        let offers = controller.core.registers.claim(self.id, names);
        let fields: Option<Vec<Input>> = names.iter().map(|name| Input::from_name(name)).collect();
        match (recipe(id, names, &offers), fields) {
            (Some(recipe), Some(fields)) => {
                self.inputs.push(InputRecipe { recipe, fields });
                Reply::SetupInputs { recipe: id, offers }
            }
            _ => Reply::SetupInputs { recipe: 0, offers },
        }
    }

    fn write(&self, shared: &RobotShared, recipe: u8, payload: &[u8]) -> Option<(Reply, Version)> {
        let Some(input) = self.inputs.iter().find(|input| input.recipe.id == recipe) else {
            return Some((self.text(&format!("there is no input recipe {recipe}")), self.version));
        };
        match input.recipe.decode(payload, Leftover::Ignore) {
            Ok(values) => {
                let mut controller = shared.controller();
                controller.core.registers.write(&input.fields, &values);
                None
            }
            Err(error) => Some((self.text(&format!("input recipe {recipe}: {error}")), self.version)),
        }
    }

    fn text(&self, message: &str) -> Reply {
        let (message, source) = (message.to_owned(), "RTDE".to_owned());
        Reply::Text(TextMessage { message, source, level: Level::Error })
    }
}

/// More names than newer software takes in one request; the replies of older software are bounded by the
/// package alone.
fn too_long(controller: &Controller, names: &[String]) -> bool {
    let bytes: usize = names.iter().map(|name| name.len() + 1).sum();
    controller.core.version()[0] >= BOUNDED_SINCE && bytes > MAX_NAMES + 1
}

/// Frames between two packages; `None` for a frequency that is refused.
fn interval(frequency_hz: f64) -> Option<u64> {
    if frequency_hz.is_nan() || frequency_hz <= 0.0 {
        return None;
    }
    let frames = (FRAMES_PER_SECOND as f64 / frequency_hz).floor();
    Some(frames.clamp(1.0, 1e6) as u64)
}

/// The recipe, if all names can be had and there is at least one.
fn recipe(id: u8, names: &[String], offers: &[Offer]) -> Option<Recipe> {
    let fields: Option<Vec<_>> = names
        .iter()
        .zip(offers)
        .map(|(name, offer)| match offer {
            Offer::Type(kind) => Some((name.clone(), *kind)),
            Offer::NotFound | Offer::InUse => None,
        })
        .collect();
    fields.filter(|fields| !fields.is_empty()).map(|fields| Recipe { id, fields })
}
