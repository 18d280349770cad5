// All pages. The navigation is this list: a page with `nav` stands there under its group, if the key has its scope.
//
// path   after the "#"; ":name" is a part that the page gets as params.name
// name   in the navigation
// scope  that the key needs: "locate", "survey", "admin"; null: any key
// load   the module, fetched when the page is first opened

export const pages = [
  { path: "/overview", name: "Overview", icon: "live", group: "Now", nav: true, scope: null, load: () => import("./overview.js") },
  { path: "/sessions", name: "Sessions", icon: "route", group: "Now", nav: true, scope: "locate", load: () => import("./sessions.js") },
  { path: "/sessions/:session_id", scope: "locate", under: "/sessions", load: () => import("./session.js") },
  { path: "/devices", name: "Devices", icon: "phone", group: "Now", nav: true, scope: "locate", load: () => import("./devices.js") },
  { path: "/devices/:device_id", scope: "locate", under: "/devices", load: () => import("./device.js") },
  { path: "/venues", name: "Venues", icon: "building", group: "Places", nav: true, scope: null, load: () => import("./venues.js") },
  { path: "/venues/:venue_id", scope: null, under: "/venues", load: () => import("./venue.js") },
  { path: "/surveys", name: "Surveys", icon: "survey", group: "Maps", nav: true, scope: "survey", load: () => import("./surveys.js") },
  { path: "/surveys/:survey_id", scope: "survey", under: "/surveys", load: () => import("./survey.js") },
  { path: "/contributions", name: "Contributions", icon: "check", group: "Maps", nav: true, scope: "survey", load: () => import("./contributions.js") },
  { path: "/levels/:level_id", scope: null, under: "/venues", load: () => import("./level.js") },
  { path: "/geofences", name: "Geofences", icon: "fence", group: "Places", nav: true, scope: null, load: () => import("./geofences.js") },
  { path: "/webhooks", name: "Webhooks", icon: "link", group: "Service", nav: true, scope: "admin", load: () => import("./webhooks.js") },
  { path: "/operations", name: "Operations", icon: "chart", group: "Service", nav: true, scope: "admin", load: () => import("./operations.js") },
  { path: "/keys", name: "Keys", icon: "key", group: "Service", nav: true, scope: "admin", load: () => import("./keys.js") },
];

/** Where the dashboard begins. */
export const HOME = "/overview";
