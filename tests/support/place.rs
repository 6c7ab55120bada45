//! A folder to run the program in, and a run that is interrupted.

use assert_cmd::{Command, assert::Assert, cargo::cargo_bin_cmd};
use std::{fs, path::PathBuf};
use tempfile::TempDir;

/// A folder of its own with some manifolds in it.
pub struct Place {
    folder: TempDir,
}

impl Place {
    /// With `files`: names and texts.
    pub fn with(files: &[(&str, &str)]) -> Self {
        let folder = TempDir::new().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    /// Runs the program there with `arguments`, which are divided at spaces.
    pub fn bake(&self, arguments: &str) -> Assert {
        let mut command: Command = cargo_bin_cmd!("geofan-bake");
        command.current_dir(self.folder.path()).env("NO_COLOR", "1");
        command.args(arguments.split(' ')).assert()
    }

    /// The same, stopped as soon as there is the file or folder `sign`: what was said.
    #[cfg(unix)]
    pub fn interrupted(&self, arguments: &str, sign: &str) -> String {
        use std::process::{Command, Stdio};
        let mut child = Command::new(env!("CARGO_BIN_EXE_geofan-bake"))
            .current_dir(self.folder.path())
            .args(arguments.split(' '))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        while !self.path(sign).exists() {
            assert!(child.try_wait().unwrap().is_none(), "over before {sign}");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        let kill = Command::new("kill").arg(child.id().to_string()).status();
        assert!(kill.unwrap().success());
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(75), "{text}");
        text
    }
}
