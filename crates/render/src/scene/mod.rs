//! What stands in the manifold: scene files, meshes, materials and the pictures they name.
//!
//! In: paths. Out: [`SceneFile`] and [`Mesh`], checked, with warnings for what was mended.

mod camera;
mod clip;
mod exponential;
mod file;
#[cfg(feature = "formats")]
mod formats;
#[cfg(feature = "gltf")]
mod gltf_material;
#[cfg(feature = "gltf")]
mod gltf_mesh;
#[cfg(feature = "gltf")]
mod gltf_source;
#[cfg(feature = "formats")]
mod libraries;
mod material;
#[cfg(feature = "formats")]
mod material_shelf;
mod mesh;
mod motion;
#[cfg(feature = "formats")]
mod mtl;
#[cfg(feature = "formats")]
mod obj;
#[cfg(feature = "formats")]
mod obj_mesh;
mod packed_mesh;
mod packed_numbers;
mod packed_placement;
mod placement;
#[cfg(feature = "formats")]
mod ply_mesh;
#[cfg(feature = "formats")]
mod polygon;
mod poses;
#[cfg(feature = "formats")]
mod smoothing;
mod subdivide;
mod table;
#[cfg(feature = "formats")]
mod text;
mod texture;
mod trajectory;

pub use camera::{CameraProjection, Lens, Stereo, StereoLayout, USUAL_FOV};
pub use file::{
    CameraEntry, CameraPosition, LightEntry, ObjectEntry, Placement, SceneFile, SkyEntry,
};
pub use material::Material;
pub use mesh::Mesh;
pub use motion::{CameraMotion, Formulas};
pub use packed_mesh::pack as pack_meshes;
#[cfg(feature = "formats")]
pub(super) use packed_mesh::{materials_are_exact, put_materials, take_materials};
pub(super) use packed_numbers::take_chunk;
pub use packed_placement::{Cuts, pack_cuts, pack_points, read_cuts, read_points};
pub use placement::placed_once;
pub(super) use placement::{Placed, place};
pub use poses::{KeyPose, PoseFile};
pub use subdivide::Points;
pub use texture::{Mapping, OpacityMap, Texture, TextureMap};
pub use trajectory::{Course, Trajectory};
