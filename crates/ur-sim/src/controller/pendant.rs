//! What is on the pendant and what the dashboard may change there: loaded program, installation, popups,
//! operational mode, user role; and which controller this claims to be.
//!
//! In: commands. Out: what was chosen. The pendant has no screen; nothing here moves the arm. Pure.

/// The one installation there is.
pub const INSTALLATION: &str = "default.installation";

/// Roles of the old user management, which newer controllers still answer to.
const ROLES: [&str; 5] = ["PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED"];

/// Checksum of the safety configuration as delivered.
pub const SAFETY_CHECKSUM: u32 = 0x5afe_c0de;

/// Who may do what at the pendant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OperationalMode {
    /// Not controlled by the dashboard.
    #[default]
    None,
    /// Loading and editing at the pendant.
    Manual,
    /// Running programs only.
    Automatic,
}

impl OperationalMode {
    /// As the dashboard prints it.
    pub fn name(self) -> &'static str {
        match self {
            OperationalMode::None => "NONE",
            OperationalMode::Manual => "MANUAL",
            OperationalMode::Automatic => "AUTOMATIC",
        }
    }

    /// The mode that `set operational mode` may request.
    pub fn from_name(name: &str) -> Option<OperationalMode> {
        [OperationalMode::Manual, OperationalMode::Automatic]
            .into_iter()
            .find(|mode| mode.name().eq_ignore_ascii_case(name))
    }

    /// `operational mode selector` of the primary interface.
    pub fn selector(self) -> u8 {
        u8::from(self == OperationalMode::Automatic)
    }
}

/// Why a program cannot be loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadError {
    /// There is no such file.
    NotFound,
    /// Its script cannot be compiled.
    Wrong,
}

/// What was chosen at the pendant.
#[derive(Clone, Debug)]
pub struct Pendant {
    /// Path of the loaded program, as the controller names it.
    pub program: Option<String>,
    /// Set by the dashboard.
    pub operational_mode: OperationalMode,
    /// A popup of the safety system is open.
    pub safety_popup: bool,
    /// Checksum of the safety configuration.
    pub safety_checksum: u32,
    /// The freedrive button is held.
    pub freedrive: bool,
    /// Reports that were requested.
    pub flight_reports: u32,
    /// Reports that can be downloaded: names and texts.
    pub reports: Vec<(String, String)>,
    role: &'static str,
    version: Option<[u32; 4]>,
    model: Option<String>,
}

impl Default for Pendant {
    fn default() -> Pendant {
        Pendant {
            program: None,
            operational_mode: OperationalMode::None,
            safety_popup: false,
            safety_checksum: SAFETY_CHECKSUM,
            freedrive: false,
            flight_reports: 0,
            reports: Vec::new(),
            role: ROLES[0],
            version: None,
            model: None,
        }
    }
}

impl Pendant {
    /// The user role.
    pub fn role(&self) -> &'static str {
        self.role
    }

    /// Sets the user role; false if there is none of that name.
    pub fn set_role(&mut self, name: &str) -> bool {
        let role = ROLES.into_iter().find(|role| role.eq_ignore_ascii_case(name));
        self.role = role.unwrap_or(self.role);
        role.is_some()
    }

    /// Software version that is claimed, if it is not the true one.
    pub fn claimed_version(&self) -> Option<[u32; 4]> {
        self.version
    }

    /// Model that is claimed, if it is not the true one.
    pub fn claimed_model(&self) -> Option<&str> {
        self.model.as_deref()
    }

    /// Claims another software version (a fault), or reports the true one again.
    pub fn pretend_version(&mut self, version: Option<[u32; 4]>) {
        self.version = version;
    }

    /// Claims to be another robot (a fault), or reports the true model again.
    pub fn pretend_model(&mut self, model: Option<String>) {
        self.model = model;
    }
}
