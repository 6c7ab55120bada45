//! What stands in the manifold: scene files, meshes, materials and the pictures they name.
//!
//! In: paths. Out: [`SceneFile`] and [`Mesh`], checked, with warnings for what was mended.

mod camera;
mod clip;
mod file;
mod formats;
#[cfg(feature = "gltf")]
mod gltf_material;
#[cfg(feature = "gltf")]
mod gltf_mesh;
#[cfg(feature = "gltf")]
mod gltf_source;
mod libraries;
mod material;
mod mesh;
mod motion;
mod mtl;
mod obj;
mod obj_mesh;
mod placement;
mod ply_mesh;
mod polygon;
mod poses;
mod reach;
mod smoothing;
mod subdivide;
mod table;
mod tally;
mod text;
mod texture;
mod trajectory;
mod vertex;

pub use camera::{CameraProjection, Lens, Stereo, StereoLayout};
pub use file::{
    CameraEntry, CameraPosition, LightEntry, LightKind, ObjectEntry, Placement, SceneFile, SkyEntry,
};
pub use material::Material;
pub use mesh::Mesh;
pub use motion::{CameraMotion, Formulas};
pub(super) use placement::place;
pub use poses::{KeyPose, PoseFile};
pub(super) use subdivide::Points;
pub use texture::{Mapping, OpacityMap, Texture, TextureMap};
pub use trajectory::{Course, Trajectory};
