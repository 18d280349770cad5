// One venue: where it is, its levels.

export const title = "Venue";

export async function render(root, params, app) {
  const venue = await app.api.get(`/v1/venues/${params.venue_id}`);
  app.setTitle(venue.name);
  root.append(venue.name);
}
