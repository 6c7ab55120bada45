//! What stands in the manifold: scene files, meshes, materials and the pictures they name.
//!
//! In: paths. Out: [`SceneFile`] and [`Mesh`], checked, with warnings for what was mended.

mod camera;
mod file;
mod material;
mod mesh;
mod placement;
mod poses;
mod smoothing;
mod subdivide;
mod survey;
mod table;

pub use camera::{CameraProjection, Lens, Stereo, StereoLayout};
pub use file::{
    CameraEntry, CameraPosition, LightEntry, LightKind, ObjectEntry, Placement, SceneFile, SkyEntry,
};
pub use material::{Material, Texture};
pub use mesh::Mesh;
pub(super) use placement::place;
pub use poses::{KeyPose, PoseFile};
